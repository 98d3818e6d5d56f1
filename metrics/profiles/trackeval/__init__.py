"""HOTA, CLEAR and identity as TrackEval counts them: `profiles`; `prepare` has the rules of benchmarks."""
