"""Trials of accuracy_cost: how they are run, resumed and left out."""

import json
import os

import numpy as np
import pytest

from srsinv.errors import BadInput
from srsinv.jobs._cost_table import tables
from srsinv.jobs._cost_trials import FAILURES, cost_trial
from srsinv.jobs._cost_turns import measure_in_turns
from srsinv.jobs.trials import Trial, TrialRows, TrialTiming
from srsinv.memory import weighed
from srsinv.report import plot

SIZES = (16, 64, 256)


def rows_of(path=None, seed: int = 0) -> TrialRows:
    """Rows in a file, or in memory alone."""
    path = None if path is None else str(path)
    return TrialRows(TrialTiming(1, failures=FAILURES), path, "rows", {"seed": seed})


def trial(family: str, size: int, work=lambda: 2.0, group: str = "forward") -> Trial:
    """A trial that costs nothing; its error falls as the size grows."""
    return cost_trial(
        group, group, "open", family, size, lambda: work, lambda value: {"error": value / size}
    )


def some_trials() -> list[Trial]:
    """Two families of one group, one of another."""
    first = [trial(family, size) for family in ("one", "other") for size in SIZES]
    return first + [trial("third", size, group="contact") for size in SIZES]


def refusing():
    raise BadInput("The cells are too many: take fewer.")


def test_all_trials_are_measured_and_stay_in_order():
    trials = some_trials()
    rows, _ = measure_in_turns(trials, rows_of())
    assert [row["key"] for row in rows] == [each.labels["key"] for each in trials]
    assert all("failure" not in row and row["steady_call_s"] > 0 for row in rows)
    assert [row["error"] for row in rows] == [2.0 / each.labels["size"] for each in trials]


def test_without_time_all_is_left_out():
    rows, left_out = measure_in_turns(some_trials(), rows_of(), 0.0)
    assert not rows
    ds = tables(rows, left_out)
    assert ds.sizes["left"] == 3
    assert set(ds["left_sizes"].values) == {"16, 64, 256"}


def test_a_trial_that_fails_is_a_row_and_the_next_one_follows():
    trials = [trial("bad", 16, refusing), trial("good", 16), trial("good", 64)]
    rows, _ = measure_in_turns(trials, rows_of())
    assert [row.get("failure", "") for row in rows] == [
        "The cells are too many: take fewer.",
        "",
        "",
    ]
    (axes,) = plot.cost(tables(rows, []), failure="failure").axes
    assert [line.get_marker() for line in axes.lines].count("x") == 1


def test_a_further_run_measures_what_is_missing_of_a_file_that_was_cut_short(tmp_path):
    path, calls = tmp_path / "rows.jsonl", []

    def counted(size):
        return trial("one", size, lambda: calls.append(size) or 1.0)

    measure_in_turns([counted(size) for size in SIZES[:2]], rows_of(path))
    whole = path.read_bytes()
    path.write_bytes(whole[:-20])
    calls.clear()
    trials = [counted(size) for size in SIZES]
    rows, _ = measure_in_turns(trials, rows_of(path))
    assert set(calls) == set(SIZES[1:])
    assert [row["size"] for row in rows] == list(SIZES)
    assert path.read_bytes().startswith(whole[:-20])  # a file is only ever added to
    calls.clear()
    again, _ = measure_in_turns(trials, rows_of(path))
    assert not calls
    assert again[0]["steady_call_s"] == rows[0]["steady_call_s"]
    measure_in_turns(trials[:1], rows_of(path, seed=1))
    assert set(calls) == {SIZES[0]}


def test_rows_of_other_trials_are_dropped_and_the_rest_put_in_order(tmp_path):
    path, (first, second, third) = tmp_path / "rows.jsonl", some_trials()[:3]
    rows, other = rows_of(path), rows_of(path)
    rows.of(third)
    rows.of(second)
    rows.anew(third)  # a second line of its own
    other.of(first)
    rows.keep([first, third])
    labels = [json.loads(line)["labels"] for line in path.read_text().splitlines()]
    assert labels == [dict(each.labels) for each in (first, third)]
    for each in (rows, rows_of(path)):
        assert [each.known(trial) is None for trial in (first, second, third)] == [0, 1, 0]


@pytest.mark.parametrize(
    "content",
    [
        "time,value\n1,2\n",
        '{"identity": 1}\n',
        '{"identity": "a", "row": []}\n',
        '{"identity": "a", "row": {"failure": ""}}\n',
        '{"identity": "a", "row": {"trial_s": 1, "first_call_s": "long"}}\n',
        "[" * 5000 + "\n",
        "time,value",
        '{"a": 1}',
        '{"identity": 1}',
        '{"identity": "mine',
        "{",
        "\n\n\n",
        "",
    ],
)
def test_a_file_of_something_else_is_refused_and_stays(tmp_path, content):
    path = tmp_path / "table.csv"
    path.write_text(content)
    with pytest.raises(BadInput, match="line 1"):
        rows_of(path)
    assert path.read_text() == content


def test_a_file_that_cannot_be_written_is_refused(tmp_path):
    path = tmp_path / "rows.jsonl"
    measure_in_turns(some_trials()[:1], rows_of(path))
    os.link(path, tmp_path / "copy")
    (tmp_path / "link").symlink_to("mine")
    os.mkfifo(tmp_path / "pipe")
    for name in ("", "absent/rows.jsonl", "link", "pipe", "copy"):
        with pytest.raises(BadInput):
            rows_of(tmp_path / name)
    assert sorted(os.listdir(tmp_path)) == ["copy", "link", "pipe", "rows.jsonl"]


def test_a_file_that_comes_meanwhile_stays(tmp_path):
    path = tmp_path / "rows.jsonl"
    rows = rows_of(path)
    assert not path.exists()
    path.write_text("mine")
    with pytest.raises(BadInput):
        measure_in_turns(some_trials()[:1], rows)
    assert path.read_text() == "mine"


def test_rows_are_numbers_and_words_of_json(tmp_path):
    path = tmp_path / "rows.jsonl"
    measure_in_turns([trial("one", 16, lambda: np.nan)], rows_of(path))
    row = json.loads(path.read_text())["row"]
    assert row["error"] is None
    known = rows_of(path).known(trial("one", 16))
    assert known is not None
    assert np.isnan(known["error"])


def test_a_line_of_a_file_does_not_say_which_trial_it_is(tmp_path):
    path = tmp_path / "rows.jsonl"
    measure_in_turns([trial("one", 16)], rows_of(path))
    content = json.loads(path.read_text())
    content["row"] |= {"family": "other", "size": "large"}
    path.write_text(json.dumps(content) + "\n")
    (row,), _ = measure_in_turns([trial("one", 16)], rows_of(path))
    assert (row["family"], row["size"]) == ("one", 16)


def test_memory_is_what_a_call_touches():
    size = 2**25
    taken = weighed(lambda: np.ones(size // 8)).rise_bytes
    assert np.isnan(taken) or 0.9 * size < taken < 1.2 * size
