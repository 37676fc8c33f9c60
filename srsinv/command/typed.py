"""Parsing of the typed command by Hydra's own parser, with errors of one sentence each."""

import itertools
import os
import re
import shlex
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import cast

from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.core.override_parser.types import Override
from hydra.errors import HydraException, OverrideParseException
from omegaconf.errors import MissingMandatoryValue, OmegaConfBaseException
from yaml import YAMLError

from ..errors import BadInput, echo, refuse
from .help import experiments

DEEPEST = 20  # brackets within each other: Hydra's parser calls itself for each
MOST_CHARACTERS = 100_000


@contextmanager
def refusing() -> Iterator[None]:
    """Turn the errors of Hydra, OmegaConf and YAML raised inside into `BadInput`."""
    try:
        yield
    except OverrideParseException as error:
        raise BadInput(_unreadable(error.override)) from error
    except MissingMandatoryValue as error:
        key = error.full_key
        raise BadInput(f"'{key}' has no value; give one with {key}=VALUE") from error
    except (HydraException, OmegaConfBaseException, YAMLError) as error:
        reason = _one_line(f"{error}\n{error.__cause__ or ''}")
        raise BadInput(f"cannot compose the configuration: {reason}") from error


@contextmanager
def composing() -> Iterator[None]:
    """Turn whatever is raised while configuration files are read and put together into `BadInput`:
    they are a user's, and PyYAML, OmegaConf and Hydra raise many things on what is none."""
    try:
        with refusing():
            yield
    except BadInput:
        raise
    except RecursionError as error:
        raise BadInput(
            "cannot compose the configuration: one of its files includes itself or is "
            "nested too deeply; remove that part"
        ) from error
    except Exception as error:
        raise BadInput(
            f"cannot compose the configuration: {type(error).__name__}: {_one_line(str(error))}"
        ) from error


def parse(overrides: Sequence[str], root: Path) -> list[Override]:
    """Hydra's own reading of `overrides`, with configurations in `root`. Raises `BadInput`."""
    for override in overrides:
        _check_parsable(override)
        key, _, value = override.partition("=")
        refuse(
            value.strip().startswith("glob("),
            f"{echo(override)} uses glob(), which srsinv does not support: name the "
            f"options, as {key}=A,B with -m",
        )
        _check_word(override, root)
    with refusing():
        parsed = OverridesParser.create().parse_overrides(list(overrides))
    for override in parsed:
        refuse(not override.key_or_group, _unreadable(text_of(override)))
    return parsed


def _check_parsable(override: str) -> None:
    """Refuse text that would crash Hydra's parser, or that no file could hold."""
    levels = itertools.accumulate((c in "([{") - (c in ")]}") for c in override)
    deepest = max(levels, default=0)
    refuse(
        deepest > DEEPEST or len(override) > MOST_CHARACTERS,
        f"{echo(override)} has {len(override)} characters in {deepest} levels of "
        f"brackets, more than {MOST_CHARACTERS} in {DEEPEST}: put it in a file of "
        "options and give --config-dir FOLDER.",
    )
    try:
        is_text = "\0" not in override and bool(override.encode())
    except UnicodeEncodeError:
        is_text = False
    refuse(
        not is_text and override != "",
        f"{echo(override)} contains bytes that are not UTF-8 text: rename the file or "
        "folder that it names.",
    )


def _check_word(word: str, root: Path) -> None:
    """Refuse a word that is no key=value, with the correction where it is clear."""
    if "=" in word or word.startswith("~"):
        return
    remedy = ""
    if word in ("help", "version"):
        remedy = f"type srsinv --{word}"
    elif word in [each.name for each in experiments(root)]:
        remedy = f"type srsinv experiment={word}"
    elif Path(word).suffix and len(word) < 256 and os.path.lexists(word):
        remedy = f"type srsinv experiment=inspect_recording recording.path={word}"
    refuse(bool(remedy), f"'{word}' is not key=value; {remedy}")


def text_of(override: Override) -> str:
    """An override as it was typed."""
    return cast(str, override.input_line)


def _unreadable(text: str) -> str:
    key, _, value = text.partition("=")
    if re.fullmatch(r"\+{0,2}[\w./@]+", key) and value.isprintable() and value.strip("'\""):
        return (
            f"cannot read '{text}' as key=value; a text with brackets, =, ~ or non-ASCII "
            f"letters needs two kinds of quotation marks: {_as_shell_text(key, value)}"
        )
    return (
        f"cannot read '{text}' as key=value; put a value with spaces or brackets in "
        "quotes: 'key=\"some text\"'"
    )


def _as_shell_text(key: str, value: str) -> str:
    """An override whose value is a text, as a shell takes it."""
    bare = value.strip("'\"").replace("\\", "\\\\").replace("'", "\\'")
    typed = f"{key}='{bare}'"
    return shlex.quote(typed) if set(typed) & set('"$`!\\') else f'"{typed}"'


def _one_line(text: str) -> str:
    lines = (re.sub(r"\s+", " ", line).strip(" .") for line in text.splitlines())
    # The types of OmegaConf's nodes mean nothing to a user.
    return "; ".join(line for line in lines if line and "_type=" not in line)
