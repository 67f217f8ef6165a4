"""A small test bed of which a test takes only the effects it needs."""

import pytest

from crankorder.synth.load import load_scene
from crankorder.synth.scene import Scene

SMALL = """\
schema_version = 1
title = "small"
engine = "msu-optical-second"
seed = 7

[sampling]
domain = "time"
rate_hz = 8000.0
duration_s = 3.0

[speeds]
list_rpm = [600.0, 612.5, 600.0]

[quick]
speeds = { list_rpm = [600.0] }
duration_s = 0.5

[[channels]]
name = "Y"
source = "acc_y"
direction = "+Y"

[[channels]]
name = "Z"
source = "acc_z"
direction = "-Z"

[[modes]]
frequency_hz = 60.0
damping_ratio = 0.02
sensor_per_kg = { Y = 0.006, Z = 0.01 }
drive = { X = 0.2, Y = 1.0, Z = -0.3, RY = 2.0 }

[[modes]]
frequency_hz = 230.0
damping_ratio = 0.01
sensor_per_kg = { Z = 0.012 }
drive = { Y = 0.9, Z = 0.2 }

[rigid_body_per_kg]
Z = { Z = 0.003 }
"""
EFFECTS = {
    "engine_forces": "[engine_forces]\ntolerance = 1e-9\n",
    "gas_torque": "[gas_torque]\nhighest_order = 8.0\nscatter_percent = 5.0\n",
    "injected_orders": '[[injected_orders]]\norder = 6.5\ndirection = "Z"\nforce_n = 30.0\nat_speed_rpm = 600.0\n',
    "bearing_lines": '[[bearing_lines]]\nbearing = "jack shaft"\nline = "BPFO"\namplitude_m_s2 = { Z = 0.5 }\n',
    "bearing_impacts": """[[bearing_impacts]]
bearing = "jack shaft"
line = "BPFI"
peak_m_s2 = { Y = 2.0, Z = 1.0 }
resonance_hz = 1500.0
damping_ratio = 0.03
jitter_percent = 1.0
load_zone = 0.7
""",
    "tones": '[[tones]]\ncause = "mains"\nfrequency_hz = 50.0\namplitude_m_s2 = { Z = 0.2 }\nharmonics = [1.0, 0.5]\n',
    "coloured_noise": """[[coloured_noise]]
channels = ["Y", "Z"]
frequency_hz = [1.0, 1000.0]
m_s2_per_root_hz = [0.03, 0.001]
""",
    "broadband": "[broadband]\nforce_n_per_root_hz = { Y = 2.0, Z = 1.0 }\ncorner_hz = 900.0\n",
    "sensor_noise": "[sensor_noise]\nm_s2_per_root_hz = { Y = 0.002, Z = 0.001 }\n",
    "encoder": "[encoder]\npulses_per_rev = 60\n",
}


@pytest.fixture
def scene_with(tmp_path):
    """Scene of the small test bed with the named effects only, and with what else a test adds to it."""

    def make(*effects, **more):
        text = SMALL.replace("msu-optical-second", "msu-optical-second-firing") if "gas_torque" in effects else SMALL
        path = tmp_path / "scene.toml"
        path.write_text(text + "".join(EFFECTS[effect] for effect in effects))
        scene = load_scene("scene.toml", tmp_path)
        return Scene.model_construct(**{**{key: getattr(scene, key) for key in Scene.model_fields}, **more})

    return make


@pytest.fixture
def small_scene(tmp_path):
    """File of a scene with every effect but the gas, which its engine lacks."""
    path = tmp_path / "small.toml"
    path.write_text(SMALL + "".join(text for effect, text in EFFECTS.items() if effect != "gas_torque"))
    return path
