"""The command line of volatool: options, printing and exit codes; the work is in `volatool`."""
