"""CLEAR MOT, identity and HOTA, and the rules of the benchmarks that use them in images."""
