"""Every profile under its name."""
