"""Reading of configuration files: a folder of somebody else's may hold ones that never end."""

import os
from pathlib import Path
from typing import Any

import yaml
from hydra._internal.core_plugins import file_config_source
from hydra._internal.sources_registry import SourcesRegistry
from hydra.plugins.config_source import ConfigResult

from ..errors import refuse
from ..files import quoted, read_bytes

MOST_BYTES = 2**18  # of one file: PyYAML, which OmegaConf reads by, takes seconds
MOST_VALUES = 20_000  # of one file, each as often as an alias repeats it


def guard_files() -> None:
    """Let Hydra, once it is set up, refuse files that take too long."""
    SourcesRegistry.instance().types[FileConfigSource.scheme()] = FileConfigSource


class FileConfigSource(file_config_source.FileConfigSource):
    """Hydra's, with a limit on what a file may hold.

    By the same name: a launched process registers Hydra's once more, and takes no other name.
    """

    def load_config(self, config_path: str) -> ConfigResult:
        path = Path(os.path.realpath(Path(self.path, self._normalize_file_name(config_path))))
        if path.exists() and path.stat().st_size:
            what = "file of options"
            content = read_bytes(path, what=what, most=MOST_BYTES, key="--config-dir")
            refuse(
                b"*" in content and _values(content) > MOST_VALUES,
                f"{quoted(path.name)}: the {what} expands to more than {MOST_VALUES} values "
                "by its YAML aliases: use fewer aliases.",
            )
        return super().load_config(config_path)


def _values(content: bytes) -> int:
    """The values that a YAML text stands for. An alias within its own anchor counts as none, as
    what includes itself is refused where it is put together."""
    of_anchors: dict[str, int] = {}
    open_nodes: list[list[Any]] = [["", 0]]  # anchors and values up to here, the outermost first
    for event in yaml.parse(content, Loader=yaml.SafeLoader):
        if isinstance(event, yaml.AliasEvent):
            open_nodes[-1][1] += of_anchors.get(event.anchor, 0)
        elif isinstance(event, yaml.ScalarEvent | yaml.CollectionStartEvent):
            open_nodes.append([event.anchor, 1])
        if isinstance(event, yaml.ScalarEvent | yaml.CollectionEndEvent):
            anchor, values = open_nodes.pop()
            of_anchors[anchor] = values
            open_nodes[-1][1] += values
    return open_nodes[0][1]
