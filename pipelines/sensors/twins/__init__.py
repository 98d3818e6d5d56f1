"""Twins of hot loops in PyTorch, for the CPU or CUDA; `docs/learned.md` says how near they are, and how fast."""
