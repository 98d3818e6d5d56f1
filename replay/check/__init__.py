"""Errors of a log (`log_check`), its content (`survey`), and whether a replay repeats bit by bit (`verify`)."""
