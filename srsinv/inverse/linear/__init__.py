"""Any linear inverse problem: an operator, data, noise and a prior."""
