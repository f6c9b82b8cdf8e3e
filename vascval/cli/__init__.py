"""The command line: thin, and the only place that prints, draws progress bars or exits."""
