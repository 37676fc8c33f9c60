"""What a sweep gave against what was varied, from the folders of its runs."""

import json
import os
import shutil
import time
from pathlib import Path

import numpy as np
import pytest
import xarray

from srsinv.errors import BadInput
from srsinv.jobs._swept import failed_jobs
from srsinv.jobs.gather import gathered
from srsinv.report.data import dataset, scalars
from srsinv.run_folder import GATHERED, MANIFEST, RunRecord, claim
from tests.golden.check import golden_test
from tests.jobs.hostile_folders import FOLDERS
from tests.jobs.run import ROOT, command, short_run
from tests.tiers import rare

FORMS = ("gather",)

test_nothing_has_moved = golden_test(FORMS, *FORMS)

SWEEP = Path(__file__).parent / "sweep"  # signal to noise ratio by scene, one job failed


def a_run(folder: Path, typed: str, metrics: dict, arrays: xarray.Dataset | None = None) -> None:
    """A run's folder with its numbers alone, and where they are given with arrays."""
    files = {"metrics.json": json.dumps(metrics).encode()}
    if arrays is not None:
        files["result.nc"] = bytes(arrays.to_netcdf(engine="h5netcdf"))
    with claim(folder) as workspace:
        workspace.replace(files, RunRecord(f"srsinv --config-dir mine {typed}", 0))


class TestDataset:
    def test_numbers_are_numbers_with_units_and_categories_words(self):
        data = short_run("gather").dataset
        assert data["noise.snr.snr_dB"].values.tolist() == [20, 20, 30, 30, 40, 40]
        assert data["noise.snr.snr_dB"].attrs["units"] == "dB"
        assert data["scene"].values.tolist() == ["ridge", "tape"] * 3
        assert data["height_m"].attrs["units"] == "m"
        assert set(data.coords) == {"job", "noise.snr.snr_dB", "scene"}  # not what all share

    def test_what_failed_has_no_numbers(self):
        data = short_run("gather").dataset
        is_failed = data["status"].values == "failed"
        assert data["job"].values[is_failed].tolist() == ["1"]
        assert "scene.pitch_m is 0" in data["reason"].values[is_failed][0]
        np.testing.assert_array_equal(np.isnan(data["error_p_wiener"].values), is_failed)
        assert data["quality_wiener"].values[is_failed] == [""]
        assert np.isnan(data["friction"].values[0])  # null in metrics.json

    def test_a_full_grid_unstacks(self):
        data = short_run("gather").dataset
        assert data.attrs["is_grid"] == 1
        grid = data.set_index(job=["noise.snr.snr_dB", "scene"]).unstack("job")
        error = grid["error_p_wiener"].sel(scene="ridge")
        np.testing.assert_allclose(error, 10 ** (-grid["noise.snr.snr_dB"] / 20))

    def test_units_in_the_middle_of_a_name_are_those_of_the_arrays(self, tmp_path):
        metrics = {"peak_Pa_wiener": 2.0, "peak_Pa": 1.0}
        variable = {"peak": ((), 2.0, "Pa", "peak_Pa_wiener"), **scalars({"peak_Pa": 1.0})}
        a_run(tmp_path / "0", "a=1", metrics, dataset(variable, {}))
        a_run(tmp_path / "1", "a=2", metrics)
        data = gathered(tmp_path, {}).dataset
        assert data["peak_Pa_wiener"].attrs["units"] == data["peak_Pa"].attrs["units"] == "Pa"

    def test_nested_and_odd_metrics(self, tmp_path):
        """Words and numbers under one name are words; a setting is not overwritten by a metric."""
        a_run(tmp_path / "2", "group/part=a seed=1", {"seed": 1, "x": {"y": [1, None]}, "z": 1})
        a_run(tmp_path / "10", "group/part=b seed=2", {"seed": 7, "x": {"y": [3, 4]}, "z": "no"})
        data = gathered(tmp_path, {}).dataset
        assert data["job"].values.tolist() == ["2", "10"]
        assert data["seed"].values.tolist() == [1, 2]
        assert data["group.part"].values.tolist() == ["a", "b"]
        np.testing.assert_array_equal(data["x_y_1"], [np.nan, 4])
        assert data["z"].values.tolist() == ["1", "no"]
        gathered(tmp_path, {}).page.html()


def test_the_page_states_the_range_and_names_what_failed():
    result = short_run("gather")
    for part in ("Error of p", "0.0100", "40 dB", "ridge", "5 of 6 jobs"):
        assert part in result.title
    assert "noise.snr.snr_dB" not in result.title
    assert list(result.page.figures) == ["over_noise.snr.snr_dB"]
    text = result.page.html()
    assert "scene.pitch_m is 0" in text
    assert "first_call_s" not in text


def test_categories_alone_are_rows(tmp_path):
    for i, name in enumerate(("wiener", "tikhonov")):
        a_run(tmp_path / str(i), f"method={name}", {"error_p": 0.1 * (i + 1)})
    assert list(gathered(tmp_path, {}).page.figures) == ["by_settings"]


def test_the_command_leaves_the_page_and_the_data(tmp_path, capsys):
    """The sweep itself is only read."""
    folder = tmp_path / "old"
    shutil.copytree(SWEEP, folder)
    before = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    chosen = "gather.metrics=[height_m]"
    assert command(tmp_path / "run", "experiment=gather", f"gather.folder={folder}", chosen) == 0
    assert capsys.readouterr().out.splitlines()[-2] == str(tmp_path / "run" / GATHERED[1])
    with xarray.open_dataset(tmp_path / "run" / GATHERED[0], engine="h5netcdf") as data:
        assert data["shown"].values.tolist() == ["height_m"]
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == before


@pytest.mark.parametrize(
    ("chosen", "words"), [(["heights"], "'heights'"), (["quality_wiener"], "is not a number")]
)
def test_metrics_that_are_none(chosen, words):
    with pytest.raises(BadInput, match=words):
        gathered(SWEEP, {}, chosen)


@pytest.mark.parametrize("folder", ["absent", "configs"])
def test_a_folder_without_runs(tmp_path, capsys, folder):
    named = f"gather.folder={ROOT / folder}"
    assert command(tmp_path / "run", "experiment=gather", named) == 2
    assert "give the folder of a sweep" in capsys.readouterr().err
    assert not (tmp_path / "run").exists()


# Folders that anybody may have made

MOST_S = 5.0
DRAWN = ("code in an override", "numbers beyond plots", "failures, escapes", "names of folders")


@pytest.mark.parametrize("case", FOLDERS)
def test_a_folder_of_anybody_is_gathered_or_refused(tmp_path, case):
    """Soon, and as printable text; good runs beside a bad one are there."""
    for i in range(2):
        a_run(tmp_path / f"good{i}", f"a={i}", {"good": float(i)})
    FOLDERS[case](tmp_path)
    start = time.monotonic()
    result, sentence = None, "Give the folder of a sweep."
    try:
        result = gathered(tmp_path, failed_jobs(tmp_path))
    except BadInput as refusal:
        sentence = str(refusal)
    assert sentence.isprintable()
    assert sentence.endswith(".")
    if result is None:
        assert "failures.json" in sentence
    else:
        data = result.dataset
        assert data["good"].sum() == 1
        texts = [each for v in data.variables.values() if v.dtype.kind in "OU" for each in v.values]
        units = [v.attrs["units"] for v in data.variables.values()]
        every = [result.title, *map(str, data.variables), *units, *np.ravel(texts)]
        assert [text for text in every if not text.isprintable() or len(text) > 3000] == []
        bytes(data.to_netcdf(engine="h5netcdf"))
    assert time.monotonic() - start < MOST_S


@pytest.mark.full
@pytest.mark.parametrize("name", rare([MANIFEST, "metrics.json"], "metrics.json"))
def test_a_large_file_under_many_names_is_refused_soon(tmp_path, name):
    a_run(tmp_path / "0", "a=0", {"m": 1.0})
    files = {f"{i:x}": 0 for i in range(65_000)}
    whole = {"command": "srsinv", "files": files, "seed": 0, "version": "1"}
    document = whole if name == MANIFEST else {"m": [1] * 500_000}
    large = tmp_path / "0" / name
    large.write_text(f"{json.dumps(document, sort_keys=True, indent=2)}\n")
    for i in range(1, 300):
        a_run(tmp_path / str(i), f"a={i}", {"m": 1.0})
        (tmp_path / str(i) / name).unlink()
        os.link(large, tmp_path / str(i) / name)
    start = time.monotonic()
    with pytest.raises(BadInput, match=f"its {name} files have more than"):
        gathered(tmp_path, {})
    assert time.monotonic() - start < 4 * MOST_S


@pytest.mark.full
@pytest.mark.parametrize("case", DRAWN)
def test_the_page_of_such_a_folder_is_text(tmp_path, capsys, case):
    for i in range(2):
        a_run(tmp_path / "sweep" / f"good{i}", f"a={i}", {"good": float(i)})
    FOLDERS[case](tmp_path / "sweep")
    code = command(tmp_path / "run", "experiment=gather", f"gather.folder={tmp_path / 'sweep'}")
    said = capsys.readouterr()
    assert code == (2 if "failures.json" in said.err else 0)
    page = (tmp_path / "run" / GATHERED[1]).read_text() if code == 0 else ""
    assert all(line.isprintable() for text in (page, *said) for line in text.split("\n"))
    assert "Traceback" not in said.err
    assert "ignored" not in said.err
