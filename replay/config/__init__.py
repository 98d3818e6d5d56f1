"""What a user says about logs in an `fbench.toml`."""
