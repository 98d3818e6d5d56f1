"""The core of fbench: what a log is and how it is played."""
