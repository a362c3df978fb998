"""DPPO with a variance penalty: the algorithm, the vocabulary and the files of a run."""
