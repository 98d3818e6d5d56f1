"""How fbench itself counts: the profile `default`."""
