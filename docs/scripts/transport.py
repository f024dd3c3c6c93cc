"""Radial reflectance of a semi-infinite medium, by the volumetric path tracer of Mitsuba 3.

The medium fills the half-space below a plane, is homogeneous, scatters isotropically and extinguishes
1/mm, so that lengths in mm are mean free paths. Its boundary does not refract. Light of unit power enters
at one point:

- "searchlight": perpendicularly;
- "diffuse": from all sides, its directions cosine-weighted.

R(r), in 1/mm^2, is the flux per area that leaves at distance r from that point, in all directions.

How: the boundary is an area light that shines into the medium, its radiance a texture over the radius. By
reciprocity, what paths from the point see on average is the integral of R times that radiance over the
plane. So its derivative with respect to a texel is the power that leaves through that texel's ring, and
Mitsuba's path replay (`prbvolpath`) finds all these derivatives in one run. Nothing of the transport is
ours: free paths, scattering, crossing the boundary and Russian roulette are Mitsuba's. Batches have their
own seeds, and the spread between them is the standard error.

Writes `docs/data/transport.csv`, a line per ring: r_mm is the mean radius over the ring's area, R the
mean of R(r) over the ring's area, sigma its standard error, albedo the exact total reflectance (by
Chandrasekhar's H function), r_inner_mm and r_outer_mm the ring's edges. Far out R falls much within a
ring, so a model should be compared by its mean over the ring, not by its value at r_mm.

Run in an environment with mitsuba, numpy and scipy: `python docs/scripts/transport.py`, about ten minutes
on two cores. Mitsuba needs LLVM's shared library, version 15 is too old and 19 works; DRJIT_LIBLLVM_PATH
says where it is.
"""

import argparse
import csv
import itertools
import time
from pathlib import Path

import drjit as dr
import mitsuba as mi
import numpy as np
from scipy.integrate import quad

mi.set_variant("llvm_ad_mono")

#: Single-scattering albedos that reflect about 0.2, 0.5 and 0.8 of a perpendicular beam, and how many
#: scatterings precede Russian roulette: until then paths lose weight and do not end, for the faint far rings.
ROULETTE = {0.7: 15, 0.94: 40, 0.994: 100}
#: Paths of a batch.
PATHS = {0.7: 4_000_000, 0.94: 2_000_000, 0.994: 800_000}
BATCHES = 25
#: Extinction of the medium, 1/mm.
EXTINCTION = 1.0
ILLUMINATIONS = ("searchlight", "diffuse")

#: Length of the scene's unit, mm: small, since Mitsuba moves a ray that crosses a surface by 1e-4 units.
UNIT = 0.01
#: The plane ends at this radius, mm; a texel is a ring of this width, mm.
PLANE, TEXEL = 500.0, 0.001
#: The edges of the rings that are written, mm, rounded to texels.
EDGES = np.round(np.geomspace(0.02, 20.0, 41) / TEXEL).astype(int) * TEXEL

CSV = Path(__file__).parents[1] / "data" / "transport.csv"
HEADER = (
    "illumination", "single_scattering_albedo", "r_mm", "R", "sigma", "albedo", "r_inner_mm", "r_outer_mm",
)  # fmt: skip


# --- what is known exactly


def h_function(single_scattering_albedo: float, nodes: int = 200):
    """Chandrasekhar's H(mu) of isotropic scattering, as a function of mu = cos(angle to the normal)."""
    mu, weight = np.polynomial.legendre.leggauss(nodes)
    mu, weight = (mu + 1) / 2, weight / 2
    root = np.sqrt(1 - single_scattering_albedo)

    def applied(at, h):
        kernel = mu / (np.asarray(at)[..., None] + mu)
        return 1 / (root + single_scattering_albedo / 2 * (kernel * h) @ weight)

    h = np.ones(nodes)
    for _ in range(10_000):
        last, h = h, applied(mu, h)
        if np.max(np.abs(h - last)) < 1e-13:
            break
    return lambda at: applied(at, h)


def total_reflectance(illumination: str, single_scattering_albedo: float) -> float:
    """Share of the power that leaves again: 1 - H(mu) sqrt(1 - albedo) of what enters along mu."""
    h = h_function(single_scattering_albedo)

    def reflected(mu):
        return 1 - float(h(mu)) * np.sqrt(1 - single_scattering_albedo)

    if illumination == "searchlight":
        return reflected(1.0)
    return quad(lambda mu: 2 * mu * reflected(mu), 0, 1)[0]


# --- transport by Mitsuba


def half_space(single_scattering_albedo: float) -> mi.Scene:
    """The medium below z = 0, whose boundary shines into it."""
    # A disk's first texture coordinate is the radius; two rows, since a bitmap has at least two.
    radiance = mi.TensorXf(np.ones((2, round(PLANE / TEXEL), 1), dtype=np.float32))
    return mi.load_dict({
        "type": "scene",
        "boundary": {
            "type": "disk",
            "to_world": mi.ScalarTransform4f().scale([PLANE / UNIT, PLANE / UNIT, 1.0]),
            # Its outside is the medium: a light shines to the outside of its shape.
            "flip_normals": True,
            "bsdf": {"type": "null"},
            "exterior": {
                "type": "homogeneous",
                "albedo": single_scattering_albedo,
                "sigma_t": UNIT * EXTINCTION,
                "phase": {"type": "isotropic"},
                # Every radius is as bright, so a point drawn on the plane would almost never be near.
                "sample_emitters": False,
            },
            "light": {
                "type": "area",
                "radiance": {
                    "type": "bitmap", "data": radiance, "raw": True,
                    "filter_type": "nearest", "wrap_mode": "clamp",
                },
            },
        },
    })  # fmt: skip


def entering(illumination: str, sampler: mi.Sampler) -> mi.Ray3f:
    """Rays from a unit above to the point at which the light enters."""
    up = mi.Vector3f(0.0, 0.0, 1.0)
    if illumination == "diffuse":
        up = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    return mi.Ray3f(mi.Point3f(up), -up)


def leaving(scene: mi.Scene, illumination: str, roulette: int, paths: int, seed: int) -> np.ndarray:
    """Power that leaves through each texel's ring, of unit power that enters."""
    integrator = mi.load_dict({"type": "prbvolpath", "max_depth": -1, "rr_depth": roulette})
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, paths)
    params = mi.traverse(scene)
    key = "boundary.emitter.radiance.data"
    dr.enable_grad(params[key])
    dr.clear_grad(params[key])
    params.update()
    ray = entering(illumination, sampler)
    with dr.suspend_grad():
        # The radiance seen is needed only for derivatives with respect to the medium: it may be 0 here.
        integrator.sample(
            dr.ADMode.Backward, scene, sampler, ray,
            δL=mi.Spectrum(1.0), state_in=mi.Spectrum(0.0), active=mi.Bool(True),
        )  # fmt: skip
    return np.array(dr.grad(params[key]), dtype=float).sum(axis=(0, 2)) / paths


def batches(illumination: str, single_scattering_albedo: float, paths: int, seeds: range) -> np.ndarray:
    """Power per batch that leaves within the first ring, in each ring, and beyond the last."""
    scene = half_space(single_scattering_albedo)
    roulette = ROULETTE[single_scattering_albedo]
    bounds = np.concatenate([[0], np.round(EDGES / TEXEL).astype(int)])
    return np.stack([
        np.add.reduceat(leaving(scene, illumination, roulette, paths, seed), bounds) for seed in seeds
    ])  # fmt: skip


def mean_and_error(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean over batches, and its standard error from their spread."""
    return values.mean(axis=0), values.std(axis=0, ddof=1) / np.sqrt(len(values))


def rows(illumination: str, single_scattering_albedo: float, power: np.ndarray) -> list[tuple]:
    """The rings' lines of the file."""
    inner, outer = EDGES[:-1], EDGES[1:]
    area = np.pi * (outer**2 - inner**2)
    radius = 2 / 3 * (outer**3 - inner**3) / (outer**2 - inner**2)
    reflectance, error = mean_and_error(power[:, 1:-1] / area)
    albedo = total_reflectance(illumination, single_scattering_albedo)
    return [
        (illumination, single_scattering_albedo, *(f"{v:.6g}" for v in (r, mean, sigma, albedo, a, b)))
        for r, mean, sigma, a, b in zip(radius, reflectance, error, inner, outer, strict=True)
    ]


def report(illumination: str, single_scattering_albedo: float, power: np.ndarray, seconds: float) -> None:
    """Print how the total compares with the exact one, and how noisy the rings are."""
    total, total_error = mean_and_error(power.sum(axis=1))
    exact = total_reflectance(illumination, single_scattering_albedo)
    mean, error = mean_and_error(power)
    relative = error[1:-1] / mean[1:-1]
    print(
        f"{illumination} {single_scattering_albedo}: total {total:.6f} +- {total_error:.6f}, "
        f"exact {exact:.6f} ({(total - exact) / total_error:+.1f} sigma); "
        f"within {EDGES[0]:g} mm {mean[0]:.6f}, beyond {EDGES[-1]:g} mm {mean[-1]:.3g}; "
        f"relative error of rings: up to 5 mm {relative[EDGES[1:] <= 5.1].max():.2%}, "
        f"up to 10 mm {relative[EDGES[1:] <= 10.1].max():.2%}, last {relative[-1]:.2%}; {seconds:.0f} s",
        flush=True,
    )


def main() -> None:
    """Simulate every case and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scale", type=float, default=1.0, help="paths of a batch, over the usual number")
    parser.add_argument("--out", type=Path, default=CSV)
    options = parser.parse_args()
    lines = []
    cases = itertools.product(ILLUMINATIONS, PATHS.items())
    for case, (illumination, (single_scattering_albedo, paths)) in enumerate(cases):
        start = time.perf_counter()
        seeds = range(case * BATCHES, (case + 1) * BATCHES)  # of its own, so that the cases are independent
        power = batches(illumination, single_scattering_albedo, round(options.scale * paths), seeds)
        report(illumination, single_scattering_albedo, power, time.perf_counter() - start)
        lines += rows(illumination, single_scattering_albedo, power)
    with options.out.open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(HEADER)
        writer.writerows(lines)


if __name__ == "__main__":
    main()
