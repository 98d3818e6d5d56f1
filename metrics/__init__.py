"""Metrics: one matcher, and scores as raw counts that can be added over runs."""
