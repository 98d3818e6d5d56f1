"""`fbench.toml` (`configuration`), the log and replay that a user asks for (`source`, `request`), guessing (`init`)."""
