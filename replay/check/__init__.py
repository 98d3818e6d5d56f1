"""What is wrong with a log (`log_check`), what it holds (`survey`), and whether a replay repeats bit by bit (`verify`)."""
