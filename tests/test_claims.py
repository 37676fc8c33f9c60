"""README's numbers are those that its commands gave, and every study is of what it says."""

import json

import pytest

from tests.claims import readme
from tests.claims.__main__ import STUDIES, study
from tests.claims.study import RESULTS, Study, read

UNFINISHED = {"lab_cases", "measured_kernels", "plans"}  # hours to come
ENV = readme.environment()
SAID = [
    (readme.digits(0.0832, "%"), "8.3"),
    (readme.digits(0.97), "0.97"),
    (readme.digits(0.0), "0"),
    (readme.digits(12559, figures=3), "12600"),
    (readme.with_error(3.80061e-3, 1.5e-6, "mm"), "3.8006 ± 0.0015"),
    (readme.with_error(6009.2, 93.0), "6009 ± 93"),
    (readme.power(2.4e-4), "2e-4"),
    (readme.power(0.0), "0"),
    (readme.duration(17.0), "20 s"),
    (readme.duration(95.0), "2 min"),
    (readme.other_lines({"lines": 0}), "none"),
    (readme.other_lines({"lines": 2, "line_1_m": 0.0201, "line_2_m": 1e-3}),
     "20.10, and shorter ones"),
]  # fmt: skip


@pytest.mark.parametrize(("written", "meant"), SAID)
def test_numbers_are_written_for_reading(written, meant):
    assert written == meant


def test_pages_say_what_was_measured():
    """Else: python -m tests.claims.readme."""
    assert not list(readme.stale())


@pytest.mark.parametrize("name", sorted(set(STUDIES) - UNFINISHED))
def test_every_case_of_a_study_is_measured_as_it_stands(name):
    """Else: python -m tests.claims NAME."""
    assert not list(map(str, study(name).missing()))


@pytest.mark.parametrize("name", sorted(path.stem for path in RESULTS.glob("*.jsonl")))
def test_rows_and_summary_are_those_of_the_cases(name):
    """Else: python -m tests.claims NAME."""
    own = study(name)
    missing = {str(each) for each in own.missing()}
    labels = [dict(each.labels) for each in own.trials() if str(each) not in missing]
    rows = read(name)
    assert [
        {key: row[key] for key in each} for row, each in zip(rows, labels, strict=True)
    ] == labels
    assert own.summary is None or (RESULTS / f"{name}.json").read_text("utf-8") == own.summarised()


def test_bursts_are_within_their_intervals_and_none_is_claimed_without():
    """Of 200 passes of 3 and of 4 elements, and of passes without bursts."""
    rows = {row["setting"]: row for row in read("bursts")}
    for setting in ("3 elements", "4 elements"):
        row = rows[setting]
        inside = [row[f"{name}_in_90_percent"] for name in ("time", "place", "size", "decay")]
        assert 86 <= min(inside) <= max(inside) <= 94
        within = [row[f"{name}_within_2_percent"] for name in ("time", "place", "size", "decay")]
        assert min(within) > 94
        assert row["rate_in_90_percent"] > 86
        assert row["false"] == 0
    assert rows["1 element"]["located_percent"] == 0
    assert rows["4 elements"]["located_percent"] > rows["3 elements"]["located_percent"] > 50
    assert rows["4 elements, recorded"]["false"] == 0
    assert rows["4 elements, recorded"]["located_percent"] > 70
    silent = [row for row in rows.values() if "no bursts" in row["setting"]]
    assert max(row["passes_with_false_percent"] for row in silent) <= 2


def test_contact_events_are_found_with_as_many_false_alarms_as_stated():
    """Episodes have few surplus events, and full slip is found in most of them, but not where
    friction does not fall."""
    rows = read("contact_events")
    for row in rows:
        if row["what"] == "episodes":
            assert row["extra_per_episode"] < 0.15
            assert row["first_contact_detected"] == row["edge_detected"] == 1
        if row["what"] == "matched_alarms":
            assert row["alarms_low_per_s"] < row["stated_per_s"] < row["alarms_high_per_s"]
    (both,) = (row for row in rows if row.get("elements") == 2 and row["noise_factor"] == 1)
    (slip,) = (row for row in rows if row["what"] == "full_slip")
    assert 0.5 < both["full_slip_correct"] < slip["bound_at_known_time"]
    assert slip["when_steady"] < 0.05


def test_film_and_accelerometer_together_gain_where_one_hides_the_other():
    """As docs/explanation/paper.md says: friction on unknown roughness, and little elsewhere."""
    rows = {
        (row["what"], row["variation"]): row for row in read("skin_acceleration") if "gain" in row
    }
    gain, least, most = rows["friction", "amplitudes scatter by 1"]["gain"]
    assert 0.1 < least < gain < most
    assert rows["friction", "amplitudes scatter by 1"]["film"][1] < 1 / 3 + 0.05
    nominal = [row["gain"] for (_, variation), row in rows.items() if variation == "nominal"]
    assert len(nominal) == 5
    assert max(gain for gain, *_ in nominal) < 0.05
    assert sum(least > 0 for _, least, _ in nominal) == 4


@pytest.fixture
def counted(monkeypatch, tmp_path):
    """A study that counts its calls, with results of its own."""
    monkeypatch.setattr("tests.claims.study.RESULTS", tmp_path)
    calls: list[int] = []

    def measure(size: int, unit: str):
        calls.append(size)
        return {"third": size / 3, "none": float("nan"), "unit_again": unit}

    def of(*sizes: int, **own):
        def cases():
            return [{"size": size, "unit": "mm"} for size in sizes]

        return Study("counted", measure, cases, lambda rows: {"rows": len(rows)}, **own)

    return calls, of, tmp_path


def test_a_study_measures_what_is_missing_and_what_is_named(counted):
    calls, of, folder = counted
    of(1, 2).run()
    assert calls == [1, 2]
    of(3, 1).run()
    assert calls == [1, 2, 3]
    assert [row["size"] for row in read("counted")] == [3, 1]
    assert (read("counted")[1]["third"], read("counted")[1]["none"]) == (0.3333, None)
    assert json.loads((folder / "counted.json").read_text()) == {"rows": 2}
    of(3, 1).run(["1, mm"])
    of(3, 1).run(["mm"])
    of(3, 1).run()
    assert calls == [1, 2, 3, 1, 3, 1]
    of(3, 1, rests_on=lambda size, unit: {"seed": size == 3}).run()
    assert calls[6:] == [3, 1]
    with pytest.raises(SystemExit, match="No case is called 4: 3, mm; 1, mm"):
        of(3, 1).run(["4", "1"])


def test_a_part_is_written_anew_and_nothing_else():
    text = "a\n<!-- rules: written -->\nold\n<!-- end of rules -->\nb\n"
    new = readme.renewed(text, ENV)
    assert new.startswith("a\n<!-- rules: written -->\n\n")
    assert "old" not in new
    assert new.endswith("\n\n<!-- end of rules -->\nb\n")
    assert readme.renewed(new, ENV) == new
