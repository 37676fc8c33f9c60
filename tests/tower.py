"""The run-time check of types for plots and pages, where a whole number will do for a real one."""

from beartype import BeartypeConf, beartype

checked = beartype(conf=BeartypeConf(is_pep484_tower=True))
