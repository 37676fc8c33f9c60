"""The options that the command's help lists: experiments, and the choices of every group."""

import yaml

from srsinv.__main__ import find_config_root
from srsinv.command.help import experiments, groups


def text() -> str:
    """As YAML, a name to a line."""
    root = find_config_root()
    listed = {"experiment": [each.name for each in experiments(root)], **groups(root)}
    return yaml.safe_dump(listed, sort_keys=True)
