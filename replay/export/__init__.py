"""Writing boxes of runs and logs as files that the official tools of benchmarks read."""
