"""Outcomes of boxes (`outcomes`), and precision, recall, F1 and AP of them (`scores`)."""
