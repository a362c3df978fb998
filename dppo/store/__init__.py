"""What a run leaves on disk: checkpoints and the run directory. No pickle."""
