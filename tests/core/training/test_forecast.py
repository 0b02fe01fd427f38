import json

import numpy as np
import pytest

from megrasp_core.drawing.training_curves import plot_forecast
from megrasp_core.errors import InvalidRequestError
from megrasp_core.training.forecast import fit_curve

POSES = np.geomspace(2e5, 8e6, 30)


def lines(noise: float = 0.0) -> list[dict[str, float]]:
    random = np.random.default_rng(0)
    losses = 0.52 + 0.12 * (POSES / 1e6) ** -0.43 + noise * random.standard_normal(len(POSES))
    return [
        {"poses": float(n), "validation_diffusion": float(x)}
        for n, x in zip(POSES, losses, strict=True)
    ]


def test_a_power_law_is_found_and_goes_on():
    curve = fit_curve(lines())
    assert (curve.limit, curve.gain, curve.exponent) == pytest.approx((0.52, 0.12, 0.43), abs=1e-5)
    assert curve.at(1e8) == pytest.approx(0.52 + 0.12 * 100**-0.43, abs=1e-5)


def test_the_error_is_that_of_the_noise_and_grows_ahead():
    curve = fit_curve(lines(noise=1e-3))
    assert abs(curve.at(1e8) - 0.52 - 0.12 * 100**-0.43) < 3 * curve.error(1e8)
    assert curve.residual == pytest.approx(1e-3, rel=0.4)
    assert curve.error(1e8) > 2 * curve.error(8e6)


def test_poses_before_and_after_are_left_out():
    bent = [*lines(), {"poses": 2e7, "validation_diffusion": 3.0}]
    bent[0]["validation_diffusion"] = 5.0
    assert fit_curve(bent, 2.1e5, 1e7).limit == pytest.approx(0.52, abs=1e-5)


def test_few_losses_are_refused():
    with pytest.raises(InvalidRequestError, match="7 validation losses between"):
        fit_curve(lines()[:7])


def test_the_picture_is_drawn(tmp_path):
    file = tmp_path / "losses.jsonl"
    file.write_text("\n".join(map(json.dumps, lines())))
    plot_forecast(file, POSES, POSES**-0.4, POSES / 1e9, tmp_path / "forecast.png")
    assert (tmp_path / "forecast.png").read_bytes()[:4] == b"\x89PNG"
