"""The model file: everything written is read back; every mistake is named with its line."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from imucald.core.errors import ConfigError
from imucald.simulation import VehicleModel, load_model, random_model


@pytest.mark.parametrize("model", [VehicleModel(), random_model(3), random_model(4, "motorway")])
def test_a_written_model_is_read_back_the_same(tmp_path, model):
    path = tmp_path / "model.yaml"
    path.write_text(model.to_yaml())
    assert load_model(path) == model


def test_a_model_file_needs_only_what_differs(tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text("suspension: {body_roll: false}\nmount:\n  yaw_deg: 12\n")
    model = load_model(path)
    assert model == VehicleModel().with_changes(
        {"suspension.body_roll": False, "mount.yaw_deg": 12}
    )


@pytest.mark.parametrize(
    ("text", "place", "reason"),
    [
        ("road:\n  crown: 0.02\n", ":2: road.crown", "unknown key"),
        ("chassis:\n\n  mass_kg: -3\n", ":3: chassis.mass_kg", "greater than 0"),
        ("accel:\n  bias: [1, 2]\n", ":2: accel.bias", ""),
        ("accel:\n  bias:\n    - 0\n    - .nan\n    - 0\n", ":4: accel.bias[1]", "finite"),
        ("route:\n  launch_mps2: [3, 1]\n", ":1: route", "write the lower bound first"),
        ("chassis:\n  cg_to_front_m: 9\n", ":1: chassis", "shorter than wheelbase"),
        ("chassis:\n  understeer_gradient: -1\n", ":1: chassis", "understeer_gradient"),
        ("mount:\n  shifts:\n  - {t_s: 9}\n  - {t_s: 3}\n", ":1: mount", "order of their times"),
        ("speed:\n  rate_hz: 0\n", ":2: speed.rate_hz", ""),
        ("- 1\n", "", ""),
        ("road: [\n", ":2", "YAML"),
        ("a: &x 1\nb: *x\n", ":2", "aliases"),
    ],
)
def test_mistakes_are_named_with_their_line(tmp_path, text, place, reason):
    path = tmp_path / "model.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load_model(path)
    assert f"model.yaml{place}" in str(caught.value)
    assert reason in str(caught.value)


def test_a_missing_file_is_an_error_that_names_it(tmp_path):
    with pytest.raises(ConfigError, match=r"nothing\.yaml"):
        load_model(tmp_path / "nothing.yaml")


@given(st.text(max_size=200))
@settings(max_examples=100, deadline=None)
def test_any_text_is_a_model_or_a_config_error(tmp_path_factory, text):
    path = tmp_path_factory.mktemp("model") / "model.yaml"
    path.write_text(text, encoding="utf-8", errors="replace")
    with contextlib.suppress(ConfigError):
        assert isinstance(load_model(path), VehicleModel)


def test_unknown_parameters_are_refused():
    for key in ("road.crown", "roads.crown_mean", "road", "accel.bias.x"):
        if key == "road":
            with pytest.raises(ConfigError):
                VehicleModel().with_changes({key: 1})
        else:
            with pytest.raises(ConfigError, match="no parameter"):
                VehicleModel().with_changes({key: 1})


def test_a_parameter_that_is_not_there_has_its_likes_and_the_place_of_the_list_named():
    with pytest.raises(ConfigError) as found:
        VehicleModel().with_changes({"road.crown_men": 1})
    assert "did you mean road.crown_mean" in str(found.value)
    with pytest.raises(ConfigError, match="'imucald simulate --write-model FILE' lists all"):
        VehicleModel().with_changes({"vehicle.x": 1})


def test_random_models_are_spread_as_asked():
    models = [random_model(seed) for seed in range(400)]
    yaw = np.array([m.mount.yaw_deg for m in models])
    assert stats.kstest(yaw, stats.uniform(-180.0, 360.0).cdf).pvalue > 0.01
    upright = [m for m in models if abs(m.mount.roll_deg) < 90.0]
    assert 0.85 < len(upright) / 400 < 0.95
    tilt = np.array([m.mount.roll_deg for m in upright])
    assert stats.kstest(tilt, stats.uniform(-30.0, 60.0).cdf).pvalue > 0.01
    bias = np.array([m.accel.bias for m in models]).ravel()
    assert np.std(bias) == pytest.approx(0.0980665, rel=0.1)
    gyro = np.array([m.gyro.bias for m in models]).ravel()
    assert np.std(gyro) == pytest.approx(np.radians(0.3), rel=0.1)
    scale = np.array([m.speed.scale for m in models])
    assert np.std(scale) == pytest.approx(0.01, rel=0.15)
    delay = np.array([m.speed.delay_s for m in models])
    assert stats.kstest(delay, stats.uniform(0.0, 0.3).cdf).pvalue > 0.01
    crown = np.array([m.road.crown_mean for m in models])
    fall = np.sqrt(np.mean(crown**2) + np.mean([m.road.bank_rms for m in models]) ** 2)
    assert fall == pytest.approx(0.02, rel=0.05)
    standing = np.mean([m.route.standing_first_s > 0.0 for m in models])
    assert 0.4 < standing < 0.6


def test_random_models_obey():
    assert abs(random_model(1, upside_down=True).mount.roll_deg) > 140.0
    assert random_model(1, standing_first=True).route.standing_first_s > 0.0
    assert random_model(1, standing_first=False).route.standing_first_s == 0.0
    assert random_model(1).accel.cross_axis == (0.0,) * 6
    assert np.std(random_model(1, cross_axis=0.005).accel.cross_axis) > 1e-3
    assert random_model(5) == random_model(5)
    # Forcing one draw leaves the others.
    forced = random_model(7, upside_down=True, standing_first=True)
    assert forced.accel == random_model(7, upside_down=False, standing_first=False).accel
