"""The command line: help, checks of overrides, one run or a sweep."""
