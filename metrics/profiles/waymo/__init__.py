"""Average precision as the Waymo Open Dataset counts it, also longitudinally tolerant (LET)."""
