"""What every metric means: formula, range, unit, source."""
