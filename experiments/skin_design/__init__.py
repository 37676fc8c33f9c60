"""Design of the skin: foam below it, a hard outer layer, and a film far stiffer than rubber."""

import xarray

from srsinv import config
from srsinv.errors import BadInput, refuse
from srsinv.forward.scene import Scene, SurfaceScene
from srsinv.forward.sensor import Sensor
from srsinv.forward.skin import HalfSpace
from srsinv.report.result import Result
from srsinv.report.section import sections
from srsinv.report.text import listed, quantity, significant, spoken

from .backing import height_errors
from .figures import draw_film, draw_hardness, draw_height
from .hard_skin import hard_skins
from .stiff_film import film_responses


def run(cfg: config.Config) -> Result:
    """Load and signal of a drive that errs on each backing, stresses under a hard outer layer, and
    the charge of a stiff film.

    Raises `BadInput` for a scene without a surface, a sensor that is not one flat element in an
    incompressible half space, and settings out of range.
    """
    given = cfg["skin_design"]
    with config.precision(cfg):
        line, sensor, scan = config.line(cfg), config.sensor(cfg), config.scan(cfg)
        scene = _surface(config.scene(cfg), sensor)
        data = xarray.merge([
            height_errors(line, scene, sensor, scan, given),
            hard_skins(line, scene, sensor, scan, given),
            film_responses(line, sensor, given),
        ], combine_attrs="no_conflicts")  # fmt: skip
        data.attrs |= {
            "nominal_Pa": float(scene.nominal_pressure_Pa),
            "skin": sensor.skin.words,
            "depth_m": float(sensor.depth_m),
            "speed_m_per_s": float(scan.speed_m_per_s),
            "effects_on": listed(cfg["effects"]),
        }
    plots = {"height": draw_height, "hardness": draw_hardness, "film": draw_film}
    return Result(_title(data), data, sections(__file__, **plots))


def _surface(scene: Scene, sensor: Sensor) -> SurfaceScene:
    """The scene's surface, for a sensor whose skin and film the parts can replace."""
    sensor.require_elements(1)
    surface, skin = scene.contact_scene, sensor.skin
    if surface is None:
        raise BadInput("The scene has no surface: use scene=ridge, for example.")
    is_plain = isinstance(skin, HalfSpace) and float(skin.poisson_ratio) == 0.5
    refuse(
        not is_plain,
        f"The skin is {skin.words}: give skin=half_space with skin.poisson_ratio=0.5, "
        "which this experiment puts on its own backings.",
    )
    angle = float(sensor.elements[0].angle_rad)
    refuse(angle != 0, f"The film has an angle of {angle:.4g} rad: give one that lies flat.")
    refuse(sensor.amplifier.order != 1, "The amplifier gives no rate: use amplifier=current.")
    return surface


def _title(data: xarray.Dataset) -> str:
    ends = data["load_change"].sortby(data["load_change"]).isel(backing=[0, -1])
    of = [
        f"{significant(100 * float(each), 2)} % ({spoken(each['backing'].item())})" for each in ends
    ]
    error = quantity(data.attrs["height_error_m"], "m", digits=2)
    gain = significant(float(data["line_gain"].sel(film="stiff strip")), 2)
    return (
        f"A height error of {error} changes the load by {of[0]} to {of[1]}; a bonded strip gives "
        f"{gain} times the signal of a film like rubber"
    )
