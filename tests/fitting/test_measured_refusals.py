"""What is no curve, and what no fit can answer, each with its sentence."""

import numpy as np
import pytest

from sssfit.fitting import measured

R = np.array([0.5, 1.0, 2.0, 4.0])
VALUES = np.array([0.2, 0.05, 0.01, 0.001])
THREE = np.stack([VALUES, VALUES, VALUES], axis=1)


def changed(array, place, value):
    array = array.copy()
    array[place] = value
    return array


REFUSED = {
    "shapes": (R, VALUES[:3], {}, r"r and values must be of shapes \(m,\) and .* got \(4,\) and \(3,\)"),
    "empty": (R[:0], VALUES[:0], {}, "r and values must be of shapes"),
    "unsorted": (R[[0, 2, 1, 3]], VALUES, {}, r"r must ascend without repeats, but r\[2\] = 1 mm follows 2"),
    "repeated": (changed(R, 2, 1.0), VALUES, {}, r"r\[2\] = 1 mm stands there twice"),
    "negative r": (R - 1, VALUES, {}, "r must be a distance of at least 0 mm, got -0.5"),
    "NaN": (R, changed(VALUES, 1, np.nan), {}, r"values must be finite, but values\[1, 0\] is nan"),
    "infinite r": (changed(R, 3, np.inf), VALUES, {}, r"r must be finite, but r\[3\] is inf"),
    "zero": (R, 0 * VALUES, {}, "a whole curve is 0 or negative"),
    "negative": (R, -VALUES, {}, "a whole curve is 0 or negative"),
    "one channel of zeros": (R, THREE * [1, 0, 1], {}, "a whole curve is 0 or negative"),
    "one value": (R, changed(VALUES, 3, -1e-3), {}, "at r = 4 mm one is -0.001; give sigma if that is noise"),
    "far below": (R, changed(VALUES, 3, -0.1), {"sigma": 0.01}, "must not be below 0 by more than noise"),
    "sigma of 0": (R, VALUES, {"sigma": changed(VALUES, 1, 0)}, "sigma must be above 0, .* 0 at point 1"),
    "sigma below": (R, VALUES, {"sigma": -1.0}, "sigma must be above 0, but it is -1"),
    "sigma NaN": (R, VALUES, {"sigma": np.nan}, "sigma must be finite"),
    "sigma's shape": (R, VALUES, {"sigma": VALUES[:3]}, r"sigma must be .*the shape of values"),
    "few points": (
        R[:2], VALUES[:2], {"model": "gaussians:2", "sigma": 0.1},
        "at least 4 points for the 4 parameters of gaussians:2, got 2",
    ),
    "no point for the noise": (R[:2], VALUES[:2], {}, "3 points for the 2 parameters of burley and the"),
    "only r = 0": (R[:1] * 0, VALUES[:1], {"sigma": 1.0}, "a point at r > 0"),
    "model": (R, VALUES, {"model": "burly"}, "model must be one of burley, gaussians:K.*got 'burly'"),
    "too many Gaussians": (R, VALUES, {"model": "gaussians:9"}, "K from 1 to 8, got 'gaussians:9'"),
    "no number": (R, VALUES, {"model": "gaussians:"}, "K from 1 to 8"),
    "loss": (R, VALUES, {"loss": "l1"}, "loss must be one of linear, huber, soft_l1, cauchy, got 'l1'"),
    "solver": (R, VALUES, {"solver": "newton"}, "solver must be one of optimistix, jaxopt, scipy or all"),
    "response": (R, VALUES, {"response": "disc"}, "response must be one of radial, line, edge, beam"),
    "no beam radius": (R, VALUES, {"response": "beam"}, "beam_radius must be a length in mm above 0"),
    "beam of 0": (R, VALUES, {"response": "beam", "beam_radius": 0.0}, "above 0 for a beam, got 0"),
    "radius of no beam": (R, VALUES, {"beam_radius": 1.0}, "belongs to the response 'beam', not to 'radial'"),
    "weights' name": (R, VALUES, {"weights": "areas"}, "one of sigma, area, relative, got 'areas'"),
    "sigma weights": (R, VALUES, {"weights": "sigma"}, "need the standard deviations of the values"),
    "relative": (
        R, changed(VALUES, 2, 0.0), {"weights": "relative", "sigma": 1e-3},
        "'relative' need values above 0, but at r = 2 mm one is not",
    ),
    "weights' shape": (R, VALUES, {"weights": [1.0, 2.0]}, r"weights must be of shape \(4,\), got \(2,\)"),
    "weights below 0": (R, VALUES, {"weights": [1, 1, 1, -1]}, "finite numbers of at least 0, not all 0"),
    "weights of 0": (R, VALUES, {"weights": [0, 0, 0, 0]}, "finite numbers of at least 0, not all 0"),
    "shared": (R, THREE, {"shared": ["c"]}, "shared must be among albedo, d, got 'c'"),
    "shared letters": (R, THREE, {"shared": "albedo"}, "shared must be a sequence of names, got 'albedo'"),
    "padded number": (R, VALUES, {"model": "gaussians:02"}, "K from 1 to 8, got 'gaussians:02'"),
    "channels": (R, THREE, {"channels": ["a", "b"]}, "channels must be 3 different names"),
    "channels twice": (R, THREE, {"channels": ["a", "b", "a"]}, "channels must be 3 different names"),
    "eta": (R, VALUES, {"model": "dipole", "eta": 9.0}, "eta must be from 0.3 to 3.5, got 9"),
    "cutoff": (R, VALUES, {"cutoff": 0.0}, "cutoff must be above 0, got 0"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_refusals(case):
    r, values, options, message = REFUSED[case]
    with pytest.raises(ValueError, match=message) as error:
        measured.fit(r, values, **options)
    assert "\n" not in str(error.value)
