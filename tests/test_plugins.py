"""A folder of a user's own: classes in FOLDER/plugins, named by YAML files in FOLDER."""

import hashlib
import json
import pickle
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import xarray
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

import srsinv.kinds
from srsinv import config, parts
from srsinv.__main__ import main
from srsinv.command.launch import LaunchedTask
from srsinv.errors import BadInput
from srsinv.forward.film import Film
from srsinv.forward.scan import ConstantSpeed, Motion
from srsinv.forward.scenario import Scenario
from srsinv.forward.scene import SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.grid import Periodic
from srsinv.inverse.features import FeatureFit, FeatureFitter, FeatureModel
from srsinv.inverse.gridding.cells import Window
from srsinv.inverse.nonlinear import Optimistix
from srsinv.jobs.monte_carlo import inversions
from srsinv.namespaces import open_plugins
from srsinv.report.data import key_of
from srsinv.targets import KINDS, base_of, check, make
from tests.jobs.run import ROOT
from tests.tiers import quick

# The examples of docs/how_to/write_*.md: blocks whose first line is a file's name.
GUIDES = {
    path.name: path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "docs" / "how_to").glob("write_*.md"))
}
BLOCK = re.compile(r"```(?:python|yaml)\n# (\S+)\n(.*?)```", re.DOTALL)
BLOCKS = [block for text in GUIDES.values() for block in BLOCK.findall(text)]
FILES = dict(BLOCKS) | {
    "plugins/numpy.py": "raise RuntimeError('this file was never named')\n",
    "plugins/broken.py": "import srsinv\nsrsinv.absent\n",
    "plugins/more/shared.py": "import plugins.mylab as m\n\n\nclass File(m.LabFile):\n    pass\n",
    "plugins/wordy.py": """import srsinv.kinds as k

class Wordy(k.Section):
    heading = "Wordy"
    words = "{{ ds.nothing_of_this_name }}"
""",
    "section/wordy.yaml": "# @package section.wordy\n_target_: plugins.wordy.Wordy\n",
    "plugins/unfinished.py": "import srsinv.kinds as k\n\n\nclass Mine(k.Rule):\n    pass\n",
    "rule/unfinished.yaml": "_target_: plugins.unfinished.Mine\n",
    "reader/shared.yaml": "_target_: plugins.more.shared.File\nvolts_per_count: 1.0e-8\n",
    "plugins/quits.py": "raise SystemExit(0)\n",
    "rule/quits.yaml": "_target_: plugins.quits.Rule\n",
    "plugins/faulty.py": """import srsinv.kinds as k


class Faulty(k.Method):
    code: int

    def __call__(self, problem):
        raise SystemExit(self.code) if self.code else problem.absent
""",
    "method/faulty.yaml": "# @package method.faulty\n_target_: plugins.faulty.Faulty\ncode: 0\n",
    "plugins/tv.py": "from plugins.lasso import Lasso\n\n\nclass TV(Lasso):\n    pass\n",
    "method/tv.yaml": "# @package method.tv\n_target_: plugins.tv.TV\nweight_per_Pa: 0.02\n",
    "method/nameless.yaml": "_target_: plugins.tv.TV\nweight_per_Pa: 0.02\n",
    "rule/public.yaml": "_target_: srsinv.Tikhonov\n",
    "rule/deep.yaml": "_target_: plugins.blur.StripAverage.mean.system\n",
    "rule/library.yaml": "_target_: plugins.hum.jnp.linalg.norm\n",
    "rule/noisy.yaml": "_target_: plugins.hum.Hum\nrms: 1.0\n",
    "rule/broken.yaml": "_target_: plugins.broken.Rule\n",
    "rule/absent.yaml": "_target_: plugins.absent.Rule\n",
    "rule/borrowed.yaml": "_target_: plugins.blur.StripAverage\n",
}
SMALL = ("grid.cells=64", "grid.refinement=2", "method=[tikhonov,bending,lasso]")


SENSOR = Sensor([Film(angle_rad=angle) for angle in (0.0, 1.6)])
MOTION = Motion.from_speed(np.arange(160) / 500, 0.05, -8e-3)


def simulated(feature, position_m):
    own = {"position_m": position_m, "pressure_Pa": 4e3, "shear_Pa": -1e3}
    return np.asarray(
        FeatureModel.along(SENSOR, MOTION).with_features({"it": feature})({"it": own})
    )


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mine")
    for name, text in FILES.items():
        path = folder / name
        path.parent.mkdir(exist_ok=True, parents=True)
        path.write_text(text)
    yield folder
    open_plugins(None)


@pytest.fixture(scope="module")
def run(folder, tmp_path_factory):
    into = tmp_path_factory.mktemp("runs") / "run"
    own = ("effects=[blur]", "noise=[snr,hum]", "rule=fixed", "section=[gains,residual_spectrum]")
    assert main(["--config-dir", str(folder), *SMALL, *own, f"hydra.run.dir={into}"]) == 0
    return into


@pytest.mark.full
def test_what_is_named_acts(run):
    metrics = json.loads((run / "metrics.json").read_text())
    assert metrics["weight_p_per_Pa2_tikhonov"] == pytest.approx(1e-7)
    for method in ("bending", "lasso"):
        assert metrics[f"status_{method}"] == "converged"
        assert 0 < metrics[f"error_p_{method}"] < 1
    assert metrics["chi2_per_freedom_lasso"] is not None
    assert metrics["coverage_p_lasso"] is None  # it gives no band
    assert "blur" in (run / "report.html").read_text()


def part(folder, name, kind):
    """The part that an example's YAML file stands for."""
    open_plugins(str(folder))
    return make(OmegaConf.to_container(OmegaConf.load(folder / name)), name, kind)


def symbol(scenario):
    """The response (element, component, k) of a scenario's sensor at constant speed."""
    return np.asarray(scenario.sensor.operator(LINE, scenario.scan).symbol(LINE.k))[..., 1:-1]


LINE = Periodic(64, 2e-4)
SPEED = 0.05


@pytest.mark.parametrize(
    ("name", "factor"),
    [
        ("twin", lambda k: np.cos(3e-4 * k)),
        ("ringing", lambda k: 1 / (1 + 1.2j * k * SPEED * 2e-4 - (k * SPEED * 2e-4) ** 2)),
    ],
)
def test_an_effect_of_one_part_acts_on_the_sensor(name, factor, folder):
    scenario = Scenario(None, SENSOR, ConstantSpeed(SPEED))
    own = part(folder, f"effects/{name}.yaml", "effects").apply(scenario)
    by = np.broadcast_to(factor(np.asarray(LINE.k))[1:-1], symbol(scenario).shape)
    np.testing.assert_allclose(symbol(own), by * symbol(scenario), rtol=1e-12)


def test_a_speed_profile_of_ones_own_sets_the_motion(folder):
    effect = part(folder, "effects/start.yaml", "effects")
    scenario = effect.apply(Scenario(None, SENSOR, ConstantSpeed(SPEED)))
    motion = scenario.recorder.motion(LINE, LINE, scenario.scan)
    expected = SPEED * (1 - 0.5 * np.exp(-np.asarray(motion.time_s) / 0.05))
    np.testing.assert_allclose(motion.speed_m_per_s, expected, rtol=1e-12)


@pytest.mark.full
def test_a_skin_a_surface_and_an_amplifier_of_ones_own(folder, tmp_path):
    named = ("scene=ridge", "surface@scene.surfaces.ridge=wedge", "skin=furred")
    small = (*SMALL[:-1], "method=[tikhonov]", "noise=[snr]", "effects=[start]")
    into = f"hydra.run.dir={tmp_path}/r"
    given = ["--config-dir", str(folder), *named, *small, "amplifier=counter", into]
    assert main(given) == 0
    plugins = json.loads((tmp_path / "r" / "run.json").read_text())["plugins"]
    assert list(plugins) == ["counter.py", "furred.py", "start.py", "wedge.py"]


@pytest.mark.full
def test_a_skin_of_ones_own_carries_the_surface(folder):
    surface = [part(folder, "surface/wedge.yaml", "surface")]
    skin = part(folder, "skin/furred.yaml", "skin")
    pressure = [
        SurfaceScene(2e4, surface, 0.4, each).traction(LINE, 1.0)[0].max()
        for each in (HalfSpace(youngs_modulus_Pa=7e5), skin)
    ]
    assert pressure[1] < pressure[0]


@pytest.mark.full
def test_a_solver_of_ones_own_fits(folder):
    solver = part(folder, "solver/restarted.yaml", "solver")
    strip = {"strip": part(folder, "feature/pad.yaml", "traction_feature")}
    fit = FeatureFitter.along(SENSOR, MOTION, solver)(strip, simulated(strip["strip"], 3e-3), 1e-9)
    assert type(solver.tolerating(1e-4)) is type(solver)
    assert fit.quality == "good"


@pytest.mark.full
def test_what_is_written_for_python_runs(folder):
    open_plugins(str(folder))
    made = {}
    exec(FILES["from_python.py"], made)  # the guide's own text
    assert made["estimate"].value.shape == (2, 128)
    assert made["estimate"].quality != "failed"


def test_a_load_profile_of_ones_own_is_in_a_scene(folder):
    open_plugins(str(folder))
    node: Any = OmegaConf.to_container(OmegaConf.load(folder / "scene/bell.yaml"))
    scene = parts.scene(node, None)
    p = np.asarray(scene.pressure(LINE))
    expected = 1e4 + 4e3 / np.cosh(np.asarray(LINE.x) / 1e-3) ** 2
    from_mean = 4e3 * (2e-4 / 1e-3) ** 2 / 12  # a cell's mean differs by p'' cell^2/24
    np.testing.assert_allclose(p, expected, rtol=0, atol=1.01 * from_mean)


@pytest.mark.full
def test_a_section_of_ones_own_is_on_the_page(run):
    page = (run / "report.html").read_text()
    assert page.index("Assumptions</h2>") < page.index("Gain</h2>")
    assert "The largest gain is" in page
    assert (run / "figures" / "gains.png").is_file()
    assert (run / "figures" / "residual_spectrum.png").is_file()


@pytest.mark.full
def test_a_section_whose_words_cannot_be_filled_in_is_refused(folder, tmp_path, capsys):
    small = (*SMALL[:-1], "method=[tikhonov]", f"hydra.run.dir={tmp_path}/s")
    assert main(["--config-dir", str(folder), *small, "section=[wordy]"]) == 2
    assert "The words of plugins.wordy.Wordy cannot be filled in" in capsys.readouterr().err
    assert not (tmp_path / "s").exists()


def test_an_example_is_short():
    lines = {name: len(re.findall(r"\S.*\n", text)) for name, text in BLOCKS}
    assert lines.pop("plugins/bending.py") <= 20  # a method and a prior
    assert max(lines.values()) <= 15


@pytest.mark.full
def test_a_feature_of_ones_own_is_found(folder):
    open_plugins(str(folder))
    own = part(folder, "feature/pad.yaml", "traction_feature")
    fit = FeatureFitter.along(SENSOR, MOTION)({"pad": own}, simulated(own, 3e-3), 1e-9)
    assert fit.quality == "good"
    assert fit.parameters["position_m"][0] == pytest.approx(3e-3, abs=1e-6)


@pytest.mark.full
def test_a_feature_of_a_surface_of_ones_own_is_felt_through_contact(folder):
    """Where it is, on coarse cells: the pressure is highest there."""
    open_plugins(str(folder))
    own = make(
        {"_target_": "plugins.crest.Crest", "edge_length_m": 1e-4}, "feature.crest", "feature"
    )
    assert FeatureFit({"crest": own}).is_of_surface
    plate = FeatureModel.on_window(SENSOR, MOTION, Window(-1e-2, 1e-2), 2e-5, 2e4)
    model = plate.with_features({"crest": own})
    shape = {"height_m": 2e-5, "position_m": 1e-3, "edge_length_m": 1e-4}
    params = {"crest": shape, "base_friction": 0.3, "nominal_pressure_Pa": 2e4, "gain": 1.0}
    p = np.asarray(model.traction(params)[0])
    assert float(model.line.x[p.argmax()]) == pytest.approx(1e-3, abs=4e-5)
    assert np.ptp(np.asarray(model(params))) > 0


@pytest.mark.full
def test_a_run_lists_the_plugins_that_it_was_made_with(folder, run):
    manifest = json.loads((run / "run.json").read_text())
    used = ("bending.py", "blur.py", "fixed.py", "gains.py", "hum.py", "lasso.py")
    texts = {name: (folder / "plugins" / name).read_bytes() for name in used}
    assert manifest["plugins"] == {
        name: hashlib.sha256(text).hexdigest() for name, text in texts.items()
    }
    assert str(folder) in manifest["command"]


@pytest.mark.full
def test_nothing_of_the_folder_takes_the_place_of_a_library(run):
    assert Path(np.__file__).parent.name == "numpy"
    assert not any(name in sys.modules for name in ("blur", "plugins.numpy"))


REFUSED = {
    "quits": r"plugins/quits\.py cannot be run: SystemExit: 0",
    "deep": r"'plugins\.blur\.StripAverage\.mean\.system', which is not a class",
    "library": r"'plugins\.hum\.jnp\.linalg\.norm', which is not a class",
    "noisy": r"rule\._target_ is 'plugins\.hum\.Hum', .* subclass of srsinv\.kinds\.Rule",
    "broken": r"plugins/broken\.py cannot be run: AttributeError: .*absent.*Correct it",
    "absent": r"'plugins\.absent\.Rule', which is not a class of srsinv, .* plugins/\*\.py",
    "unfinished": r"'plugins\.unfinished\.Mine', which does not define choose",
    "public": r"give srsinv\.inverse\.tikhonov\.Tikhonov",
    "borrowed": r"'plugins\.blur\.StripAverage', which is not a class",
}


@pytest.mark.parametrize("rule", quick(REFUSED, "quits"))
def test_what_cannot_stand_there_is_refused(rule, folder, tmp_path, capsys):
    given = ["--config-dir", str(folder), *SMALL, f"rule={rule}", f"hydra.run.dir={tmp_path}/r"]
    assert main(given) == 2
    assert re.search(REFUSED[rule], capsys.readouterr().err)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    ("code", "fault"), quick([(0, "AttributeError"), (3, "SystemExit")], (0, "AttributeError"))
)
def test_what_a_plugin_raises_is_said_with_its_place(code, fault, folder, tmp_path, capsys):
    named = (*SMALL[:-1], "method=[faulty]", f"method.faulty.code={code}")
    assert main(["--config-dir", str(folder), *named, f"hydra.run.dir={tmp_path}/r"]) == 2
    assert f"plugins/faulty.py raises {fault} at line 8" in capsys.readouterr().err
    assert not (tmp_path / "r").exists()


TV = {"_target_": "plugins.tv.TV", "weight_per_Pa": 0.02}
# Names of methods and their labels: as a class is written, where a name begins with the class's.
LABELS = {
    "tv": "TV",
    "tv_strong": "TV strong",
    "strong": "Strong",
    "weak_TV": "Weak TV",
    "tvs": "Tvs",
}


def test_a_method_has_the_label_of_its_name_and_class(folder):
    open_plugins(str(folder))
    methods = config.methods({"method": dict.fromkeys(LABELS, TV)})
    assert list(methods) == list(LABELS.values())
    assert {key_of(label) for label in methods} == {name.lower() for name in LABELS}


def test_two_methods_of_one_label_are_refused(folder):
    open_plugins(str(folder))
    with pytest.raises(BadInput, match="Two methods have the label 'TV'"):
        config.methods({"method": {"tv": TV, "TV": TV}})
    fit = config.methods({"method": {"feature_fit": TV, "tv": TV}})
    with pytest.raises(BadInput, match="'Feature fit', which the fit of features has"):
        inversions(fit, {}, Optimistix())


@pytest.mark.parametrize("group", config.NAMED)
def test_an_option_without_a_name_is_refused(group):
    with pytest.raises(BadInput, match=f"# @package {group}.NAME"):
        config.part({group: TV}, group)


@pytest.mark.claim
def test_two_configurations_of_a_method_keep_their_labels(folder, tmp_path, capsys):
    own = ["--config-dir", str(folder), *SMALL[:-1], f"hydra.run.dir={tmp_path}/r"]
    assert main([*own, "method=[tv]", "+method@method.tv_strong=tv"]) == 0
    with xarray.open_dataset(tmp_path / "r" / "result.nc") as data:
        assert data["estimator"].values.tolist() == ["TV", "TV strong"]
    metrics = json.loads((tmp_path / "r" / "metrics.json").read_text())
    assert {"error_p_tv", "error_p_tv_strong"} <= metrics.keys()
    assert "TV strong" in (tmp_path / "r" / "report.html").read_text()
    capsys.readouterr()
    assert main([*own[:-1], "method=[nameless]", f"hydra.run.dir={tmp_path}/s"]) == 2
    assert "# @package method.NAME" in capsys.readouterr().err


def test_without_the_folder_a_plugin_is_no_class(folder):
    node = {"_target_": "plugins.hum.Hum", "rms": 1.0}
    open_plugins(str(folder))
    assert type(make(node, "noise.hum", "noise")).__module__ == "plugins.hum"
    open_plugins(None)
    with pytest.raises(BadInput, match="which is not a class of srsinv"):
        check(node, "noise.hum", "noise")


def sections_with_classes():
    """The sections of the guides that hold a class, as links to them lead there."""
    for page, text in GUIDES.items():
        for section in re.split(r"^## ", text, flags=re.MULTILINE)[1:]:
            if "# plugins/" in section:
                heading = section.split("\n")[0].lower()
                yield f"{page}#{re.sub(r'[^a-z0-9_ -]', '', heading).replace(' ', '-')}"


def test_the_table_of_kinds_names_groups_and_bases():
    table = GUIDES["write_other_parts.md"]
    row = r"^\| \[.*\]\((\S*#\S+)\) \| (.*) \| (.*) \| .* \|$"
    rows = re.findall(row, table, re.MULTILINE)
    groups = [group.strip("`") for _, group, _ in rows if group.startswith("`")]
    bases = re.findall(r"`(\w+)`", " ".join(names for *_, names in rows))
    assert all((ROOT / "configs" / group).is_dir() for group in groups)
    assert set(bases) <= set(srsinv.kinds.__all__)
    links = [re.sub("^#", "write_other_parts.md#", link) for link, *_ in rows]
    sections = list(sections_with_classes())
    assert sorted(set(links)) == sorted(sections)


@pytest.mark.parametrize("name", srsinv.kinds.__all__)
def test_every_base_is_public(name):
    base = getattr(srsinv.kinds, name)
    assert base in {base_of(each) for names in KINDS.values() for each in names}
    assert base.__doc__


# The recording of srsinv/examples as counts, which plugins/mylab.py reads.
EXAMPLE = ROOT / "srsinv" / "examples" / "strip_two_element.csv"
VOLTS_PER_COUNT = 1e-8
STATED = ("recording.sample_rate_hz=2000", "recording.speed_m_per_s=0.04")


@pytest.fixture
def scan(tmp_path):
    volts = np.loadtxt(EXAMPLE, delimiter=",", skiprows=1)[:, 2:]
    np.round(volts / VOLTS_PER_COUNT).astype("<i2").tofile(tmp_path / "scan.lab")
    (tmp_path / "scan.json").write_bytes(EXAMPLE.with_suffix(".json").read_bytes())
    return tmp_path / "scan.lab"


def read_by(reader, folder, scan, *also):
    """The exit code of a command on `scan`, its run in the folder beside it."""
    given = (f"reader={reader}", f"recording.path={scan}", f"hydra.run.dir={scan.parent}/run")
    return main(["--config-dir", str(folder), *given, *also])


@pytest.mark.full
def test_a_reader_of_ones_own_serves_a_job(folder, scan):
    small = ("experiment=invert_recording", "method=[tikhonov]", "recording.cell_m=6e-4")
    assert read_by("lab", folder, scan, *small, *STATED) == 0
    metrics = json.loads((scan.parent / "run" / "metrics.json").read_text())
    truth = json.loads(EXAMPLE.with_suffix(".truth.json").read_text())
    assert metrics["p_peak_Pa_tikhonov"] == pytest.approx(truth["pressure_Pa"], rel=0.1)
    manifest = json.loads((scan.parent / "run" / "run.json").read_text())
    text = (folder / "plugins" / "mylab.py").read_bytes()
    assert manifest["plugins"] == {"mylab.py": hashlib.sha256(text).hexdigest()}


@pytest.mark.full
def test_the_next_command_of_an_inspection_names_the_reader_and_its_folder(folder, scan):
    assert read_by("lab", folder, scan, "experiment=inspect_recording", *STATED) == 0
    with xarray.open_dataset(scan.parent / "run" / "result.nc") as found:
        following = shlex.split(found.attrs["next_command"])
    assert "reader=lab" in following
    assert following[following.index("--config-dir") + 1] == str(folder)
    assert not any("_target_" in word for word in following)


@pytest.mark.claim
def test_each_run_of_a_sweep_lists_the_plugins_of_its_own(folder, scan):
    into = f"hydra.sweep.dir={scan.parent}/sweep"
    assert read_by("shared,lab", folder, scan, "-m", "experiment=inspect_recording", into) == 0
    runs = [json.loads((scan.parent / f"sweep/{i}/run.json").read_text()) for i in range(2)]
    assert [list(run["plugins"]) for run in runs] == [["more/shared.py", "mylab.py"], ["mylab.py"]]


# What a launcher of Hydra does in a process of its own.
APART = """
import pickle, sys
from hydra.core.hydra_config import HydraConfig
from omegaconf import open_dict
task, config = pickle.load(sys.stdin.buffer)
HydraConfig.instance().set_config(config)
with open_dict(config):
    del config["hydra"]
sys.exit(task(config).code)
"""


@pytest.mark.full
def test_a_launched_process_finds_the_plugins(folder, scan):
    into, configs = scan.parent / "run", ROOT / "configs"
    named = ("experiment=inspect_recording", "reader=lab", f"recording.path={scan}")
    searched = f"hydra.searchpath=['file://{folder}']"
    with initialize_config_dir(str(configs), version_base="1.3"):
        config = compose("config", [searched, *named], return_hydra_config=True)
    config.hydra.runtime.output_dir = str(into)
    task = LaunchedTask(configs, ("--config-dir", str(folder)), str(folder))
    sent = pickle.dumps((task, config))
    subprocess.run([sys.executable, "-c", APART], input=sent, cwd=scan.parent, check=True)
    assert list(json.loads((into / "run.json").read_text())["plugins"]) == ["mylab.py"]


@pytest.mark.parametrize(
    "experiment", quick(["inspect_recording", "fit_recording"], "inspect_recording")
)
def test_a_reader_that_fails_leaves_no_run(experiment, folder, scan, capsys):
    with scan.open("ab") as file:
        file.write(b"!")
    assert read_by("lab", folder, scan, f"experiment={experiment}", *STATED) == 2
    assert "reader plugins.mylab.LabFile cannot read" in capsys.readouterr().err
    assert not (scan.parent / "run").exists()
