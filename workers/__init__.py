"""The processes that own the environments: Algorithm 3 of Heess et al. 2017."""
