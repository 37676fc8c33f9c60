"""A problem on the cells of a line: its solvers, rules and priors."""
