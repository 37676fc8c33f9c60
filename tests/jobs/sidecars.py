"""The sensor of two elements that sidecars of small recordings state."""

SENSOR = {
    "depth_m": 7.5e-4,
    "feedback_resistance_ohm": 1e6,
    "elements": [
        {"orientation": name, "strip_width_m": 7e-4, "active_length_m": 8e-3}
        for name in ("1_to_x_3_to_z", "1_to_z_3_to_x")
    ],
}
OF_OTHER_FILM = SENSOR | {"piezo_constants_C_per_N": {"d1": 23e-12, "d2": 3e-12, "d3": -33e-12}}
