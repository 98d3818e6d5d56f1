"""Looking at a log, and writing the `fbench.toml` that says what it most probably holds."""
