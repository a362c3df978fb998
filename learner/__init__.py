"""The process that owns the parameters: Algorithm 2 of Heess et al. 2017."""
