"""The subcommands of `dppo` that need an environment: eval, export, video, watch."""
