"""Live inversion on the command line: played back, and as a filter in a pipe."""

import signal
import subprocess
import sys

import numpy as np
import pytest

from srsinv import Live, LiveCells, load
from srsinv.recorded import sensor_of
from tests.golden.check import golden_test
from tests.inverse.live.scans import prior
from tests.jobs.run import ROOT, composed, outcome, result_of, short_run
from tests.refusals import refused

EXAMPLE = ROOT / "srsinv" / "examples" / "strip_two_element.csv"
LEVELS = [f"method.wiener.{c}.{key}" for c in "pq" for key in ("rms_Pa=1500", "correlation_m=4e-4")]


FORMS = ("live",)

test_nothing_has_moved = golden_test(FORMS)


def piped(*overrides, **streams):
    """The command as a process that reads lines."""
    sidecar = f"recording.sidecar={EXAMPLE.with_suffix('.json')}"
    typed = ["experiment=live", "live.source=-", *overrides, sidecar, "method=wiener", *LEVELS]
    pipe, before = subprocess.PIPE, signal.getsignal(signal.SIGINT)
    if before is signal.SIG_IGN:  # as in a shell's background: commands started so ignore it, too
        signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "srsinv", *typed], stdin=pipe, stdout=pipe, stderr=pipe,
            text=True, cwd=ROOT, **streams,
        )  # fmt: skip
    finally:
        signal.signal(signal.SIGINT, before)


def table(lines):
    return np.array([[float(cell) for cell in line.split(",")] for line in lines])


def test_played_back_with_several_lags():
    """A longer lag has smaller standard errors, and comes nearer to the longest one's estimate,
    which is that of the batch inversion beside a slow difference."""
    data = short_run("live").dataset
    stderr, off = data["typical_stderr"].values, data["difference_rms"].values
    assert np.all(np.diff(stderr, axis=0) < 0)
    assert np.all(np.diff(off, axis=0) < 0)
    assert off[-1] == pytest.approx([0, 0])
    longest = data["live_estimate"].values[-1]
    batch = data["estimate"].values
    for c in range(2):
        assert np.corrcoef(longest[c], batch[c])[0, 1] > 0.97
    assert float(data["p_stderr_ratio"]) > 1
    assert data["noise_level"].values.min() > 0


def test_a_lag_longer_than_those_compared():
    """It takes the place of the longest one."""
    cfg = ["experiment=live", f"recording.path={EXAMPLE}", "live.memory_m=0.032"]
    data = outcome(*cfg, "live.lag_m=0.03").dataset
    assert data["lag"].values[-1] == pytest.approx(0.03)
    assert float(data["p_stderr_ratio"]) == 1


def test_an_earlier_recording_states_what_the_method_chooses(tmp_path):
    """The levels by evidence are those of the file; stated ones are as stated."""
    chosen = short_run("live").dataset.attrs
    stated = outcome(
        "experiment=live", f"recording.path={EXAMPLE}", "method=wiener", "live.memory_m=0.012"
    )
    assert (chosen["levels_chosen"], stated.dataset.attrs["levels_chosen"]) == (1, 0)


def test_a_pipe_gives_the_cells_that_python_gives(tmp_path):
    """Lines that are no samples are named on standard error, skipped and counted; every line is
    written at once; and nothing is left behind."""
    lines = EXAMPLE.read_text().splitlines(keepends=True)
    bad = ["rubbish,1,2,3\n", "1,2\n", lines[100], "\n"]
    with piped("live.lag_m=1.5e-3", f"hydra.run.dir={tmp_path / 'run'}") as process:
        out, errors = process.communicate("".join([*lines[:300], *bad, *lines[300:]]))
    assert process.returncode == 0
    header, *cells = out.splitlines()
    assert header == "x_m,p_Pa,p_stderr_Pa,q_Pa,q_stderr_Pa,noise_V"
    assert "line 301" in errors
    assert "line 302" in errors
    assert "line 303" in errors
    assert "3 of" in errors
    assert "Traceback" not in errors
    assert not (tmp_path / "run").exists()
    recording = load(EXAMPLE)
    live = Live(sensor_of(recording), prior(), lag_m=1.5e-3)
    given = recording.time_s, recording.position_m, recording.signal, recording.speed_m_per_s
    own = LiveCells.joined([live.push(*given), live.finish()])
    noise = np.sqrt(np.mean(own.noise**2, axis=0))
    wanted = [own.x_m, own.p_Pa, own.p_stderr_Pa, own.q_Pa, own.q_stderr_Pa, noise]
    assert np.allclose(table(cells), np.transpose(wanted), rtol=1e-6, atol=1e-3)


@pytest.mark.full
def test_a_signal_ends_the_stream_in_good_order():
    """Ctrl-C while the writer pauses: cells that were finished are there before, the others after,
    and there is no traceback."""
    lines = EXAMPLE.read_text().splitlines(keepends=True)
    with piped("live.lag_m=0") as process:
        process.stdin.write("".join(lines[:400]))
        process.stdin.flush()
        before = [process.stdout.readline() for _ in range(60)]
        process.send_signal(signal.SIGINT)
        rest, errors = process.stdout.read(), process.stderr.read()
    assert process.returncode == 0
    assert "Traceback" not in errors
    cells = table([*before[1:], *rest.splitlines()])
    assert np.all(np.diff(cells[:, 0]) > 0)
    assert len(cells) > 60


@pytest.mark.full
@pytest.mark.parametrize("reader_leaves", [True, False])
def test_a_broken_pipe_ends_the_stream_quietly(reader_leaves):
    """The reader leaves, as `head` does, or the writer is killed within a line."""
    lines = EXAMPLE.read_text().splitlines(keepends=True)
    with piped("live.lag_m=0") as process:
        process.stdin.write("".join(lines[:400]))
        process.stdin.flush()
        first = [process.stdout.readline() for _ in range(3)]
        assert first[0].startswith("x_m,")
        if reader_leaves:
            process.stdout.close()
            process.stdin.write("".join(lines[400:800]))
        else:
            process.stdin.write("0.9,0.04,1e-")
        process.stdin.close()
        if not reader_leaves:
            assert len(process.stdout.read().splitlines()) > 60
        errors = process.stderr.read()
    assert process.returncode == 0
    assert "Traceback" not in errors


def test_a_window_needs_a_display(monkeypatch):
    monkeypatch.setattr(sys, "platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    cfg = composed("experiment=live", f"recording.path={EXAMPLE}", "live.view=true")
    refused(lambda: result_of(cfg), "live.view", "DISPLAY")


@pytest.mark.parametrize(
    ("overrides", "words"),
    [
        (["live.source=file"], ["live.source", "recording"]),
        (["live.lag_m=-1"], ["live.lag_m"]),
        (["live.view=perhaps"], ["live.view", "true or false"]),
        (["method=[wiener,tikhonov]"], ["method", "one"]),
        (["noise=[white,sliding]"], ["sliding", "live"]),
    ],
)
def test_settings_that_cannot_be(overrides, words):
    cfg = composed("experiment=live", f"recording.path={EXAMPLE}", *overrides)
    refused(lambda: result_of(cfg), *words)
