"""Who decides how many samples a pixel gets from what was learned in the frames before."""

import functools
from typing import Any

import jax

from sssfit.estimators import policies
from sssfit.scenarios import circle, driver, light, measure
from sssfit.trade.choice import Choice, Error, Group, Task
from sssfit.trade.setting import Setting

_FRAMES, _TARGET = 240, 0.0064
_SEEDS, _QUICK_SEEDS = 1024, 256


def _prepare(setting: Setting) -> Task:
    world = circle.uniform(light.sine(_FRAMES))
    seeds = _QUICK_SEEDS if setting.is_quick else _SEEDS
    made = [_choice(name, knobs, world, seeds) for name, knobs in _choices(setting.is_quick).items()]
    return Task(
        _FRAMES * seeds, tuple(made), f"{seeds} pixels, {_FRAMES} frames of light that rises and falls"
    )


def _choices(is_quick: bool) -> dict[str, dict]:
    """Constants of the controllers by a name of their own."""
    found = {f"fixed {n}": {"name": "fixed", "spp": n} for n in ((64,) if is_quick else (16, 32, 64))}
    for name in ("as", "ccv"):
        for alpha in (0.2,) if is_quick else (0.05, 0.2):
            for kappa in (0.2,) if is_quick else (0.1, 0.2, 0.5):
                knobs = {"name": name, "alpha": alpha, "kappa": kappa}
                found[f"{name}, alpha {alpha:g}, kappa {kappa:g}"] = knobs
    for alpha in (0.02,) if is_quick else (0.01, 0.02, 0.1):
        found[f"in_frame, alpha {alpha:g}"] = {"name": "in_frame", "alpha": alpha}
    return found if is_quick else found | {name: {"name": name} for name in ("ocv", "unreal", "oracle")}


def _choice(label: str, knobs: dict, world, seeds: int) -> Choice:
    given: dict[str, Any] = {name: value for name, value in knobs.items() if name != "name"}
    aimed: dict[str, Any] = {} if knobs["name"] == "fixed" else {"target_variance": _TARGET}
    policy = policies.named(knobs["name"], **given, **aimed)

    @functools.cache
    def summary() -> measure.Summary:
        chunks = driver.chunks(jax.random.key(1), world, policy, seeds=seeds)
        return measure.summarize(measure.collect(chunks, world, measure.Target(_TARGET)))

    def run():
        return driver.run(jax.random.key(0), world, policy, seeds=seeds)

    return Choice(
        name=label,
        knobs={"controller": knobs["name"], **given},
        run=run,
        error=lambda: Error(summary().image_rmse, summary().image_rmse_se),
        samples=lambda: summary().mean_count,
        is_default=label == "as, alpha 0.2, kappa 0.2",
    )


GROUP = Group(
    name="controllers",
    title="The controller of the sample count",
    unit="pixel and frame",
    error="root mean square error of a frame's result, mean light 1",
    reference="the circle's exact answer",
    prepare=_prepare,
    beside_the_front="The default has the papers' kappa. Where light rises and falls, a larger one saves "
    "some parts in a thousand of the samples; where it stays, that asks for more of them.",
    cost="samples",
    stands_for=(
        "estimators.policies.named",
        *(
            f"estimators.sample_count.{name}"
            for name in ("init", "estimate", "basic_estimate", "round_count", "next_count", "update")
        ),
        *(
            f"estimators.in_frame.{name}"
            for name in ("init", "sample_variance", "safety", "sequence_gain", "next_count", "update")
        ),
        *(f"estimators.control_variate.{name}" for name in ("init", "upper_bound", "residual", "step")),
    ),
)
