"""Suites: cells of logs, pipelines, conditions, rates and seeds, how they are run, and the tables of what they gave."""
