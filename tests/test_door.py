"""`import srsinv`: what is public there, how soon it is loaded, and what it says of itself."""

import ast
import importlib
import inspect
import re
import subprocess
import sys
from pathlib import Path

import pytest

import srsinv
import srsinv.plot
from srsinv.targets import KINDS, base_of

ROOT = Path(__file__).resolve().parents[1]
ITEM = re.compile(r"\n\s*- |\n\s*\n")  # between the items of a docstring, and its paragraphs


def _names(module) -> list[str]:
    return [name for name in getattr(module, "__all__", dir(module)) if name[0] != "_"]


MODULES = srsinv, srsinv.kinds, srsinv.plot, srsinv.examples
PUBLIC = sorted(
    {getattr(module, name) for module in MODULES for name in _names(module)}
    - {srsinv.BadInput, *MODULES},
    key=lambda each: (each.__module__, each.__name__),
)
UNITS = {"_m_per_s": "m/s", "_m": "m", "_rad": "rad", "_hz": "Hz", "_Pa": "Pa", "_s": "s"}


def loaded_after(code: str) -> set[str]:
    """The modules that a new process has loaded once it has run `code`."""
    code = f"import sys\n{code}\nprint(*sys.modules)"
    made = subprocess.run(
        [sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return set(made.stdout.split())


def test_its_names_are_all_that_is_shown():
    import srsinv.forward.contact
    import srsinv.report.result

    assert dir(srsinv) == sorted(srsinv.__all__)
    assert not {"forward", "report", "os", "sys"} & {*dir(srsinv)}
    assert {"Film", "Sensor", "Scenario", "Periodic", "Open", "fit", "load"} <= {*dir(srsinv)}
    assert {"FeatureEstimate", "StripFeature", "LineProblem", "examples"} <= {*dir(srsinv)}


@pytest.mark.parametrize("public", PUBLIC, ids=lambda each: f"{each.__module__}.{each.__name__}")
def test_every_public_name_explains_its_arguments(public):
    """In backticks each; arrays with their shape, quantities with their SI unit. An argument of a
    base may be explained there."""
    own = [each for each in inspect.getmro(public) if "srsinv" in each.__module__] if (
        inspect.isclass(public)
    ) else [public]  # fmt: skip
    items = [re.sub(r"\s+", " ", each) for part in own for each in ITEM.split(part.__doc__ or "")]
    assert inspect.getdoc(public)
    for name, argument in inspect.signature(public).parameters.items():
        if argument.kind is inspect.Parameter.VAR_KEYWORD or name.startswith("_"):
            continue
        about = [each for item in items for each in item.split(f"`{name}`")[1:]]
        assert about, f"{name} is not explained"
        unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), None)
        with_unit = rf"(, `\w+`)*( \([\w ,]+\))? \[{unit}\]"  # behind the last name of a row
        assert unit is None or any(re.match(with_unit, each) for each in about), (
            f"{name}: [{unit}]?"
        )
        is_array = re.search(r"(Float|Complex|Bool)\[[^'\"]*['\"][^'\"]+|ndarray'>$", str(argument))
        assert not is_array or any("(" in each for each in about), f"{name}: of which shape?"


@pytest.mark.parametrize("name", ["simulate", "invert", "fit_recording", "load"])
def test_help_explains_every_argument(name):
    function = getattr(srsinv, name)
    text = inspect.getdoc(function) or ""
    assert all(f"- `{key}`: " in text for key in inspect.signature(function).parameters)
    assert "Returns" in text
    assert "Raises `BadInput`" in " ".join(text.split())


def test_plots_are_a_module_that_can_be_imported():
    assert importlib.import_module("srsinv.plot") is srsinv.plot
    assert srsinv.plot.estimates.__module__.startswith("srsinv.report.plot")
    names = dir(srsinv.plot)
    assert {"answer", "estimates", "fit", "Panel"} <= {*names}
    assert not any(inspect.ismodule(getattr(srsinv.plot, name)) for name in names)


def test_a_name_that_it_has_not_is_an_error():
    with pytest.raises(AttributeError, match="no attribute 'Sensors'"):
        _ = srsinv.Sensors  # pyright: ignore[reportAttributeAccessIssue]


def test_the_import_alone_loads_no_library():
    loaded = loaded_after("import srsinv; dir(srsinv); srsinv.BadInput")
    assert not {"jax", "numpy", "scipy", "hydra", "xarray"} & loaded


def test_recordings_are_read_without_jax():
    assert "jax" not in loaded_after("import srsinv; srsinv.load")


@pytest.mark.full
def test_double_precision_is_the_default_of_what_it_loads():
    assert "jax" in loaded_after("import srsinv; assert srsinv.Film().depth_m.dtype == 'float64'")


def names_for_type_checkers(module) -> set[str | None]:
    """The names that a module imports for type checkers alone."""
    tree = ast.parse(Path(module.__file__).read_text(encoding="utf-8"))
    block = next(
        node
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
    )
    imports = [node for node in block.body if isinstance(node, ast.ImportFrom)]
    return {alias.asname for node in imports for alias in node.names}


@pytest.mark.parametrize("module", [srsinv, srsinv.kinds], ids=["srsinv", "kinds"])
def test_type_checkers_see_the_same_names(module):
    assert names_for_type_checkers(module) == {*dir(module)}


def test_the_bases_of_kinds_are_those_of_the_configuration():
    assert {*dir(srsinv.kinds)} == {name.split(".")[-1] for each in KINDS.values() for name in each}
    assert srsinv.kinds.LineEffect is base_of("srsinv.forward.film.LineEffect")


def test_a_recording_is_loaded_with_its_sidecar():
    example = ROOT / "srsinv" / "examples" / "strip_two_element.csv"
    recording = srsinv.load(example)
    assert isinstance(recording, srsinv.Recording)
    assert recording.sidecar
    with pytest.raises(srsinv.BadInput, match="allow"):
        srsinv.load(example, missing="perhaps")


def test_the_wheel_says_that_it_is_typed():
    wheel = pytest.importorskip("hatchling.builders.wheel")
    files = {
        each.distribution_path for each in wheel.WheelBuilder(str(ROOT)).recurse_included_files()
    }
    assert {"srsinv/py.typed", "srsinv/configs/config.yaml"} <= files
