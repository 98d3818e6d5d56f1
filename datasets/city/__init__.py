"""The simulated smart city: logs of every sensor with perfect truth, made anywhere, from a seed."""
