"""The command line: help by hand, overrides checked, one run or a sweep, nothing left behind."""
