"""Which density draws the radius of a sample, and whether its difference from the profile is weighed."""

from sssfit.sampling import inverse_cdf
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_SPP = 64
_QUICK = ("log_poly12", "log_linear", "xie", "mixture")


def _prepare(setting: Setting) -> Task:
    base = _frames.base(setting)
    choices = []
    for name in _QUICK if setting.is_quick else inverse_cdf.METHODS:
        settings = base._replace(importance=name)
        knobs = {"importance": name, "corrected": True, "spp": _SPP}
        choices.append(_frames.choice(setting, name, knobs, settings, _SPP, settings == base))
    settings = base._replace(importance="xie", corrected=False)
    knobs = {"importance": "xie", "corrected": False, "spp": _SPP}
    choices.append(_frames.choice(setting, "xie, uncorrected", knobs, settings, _SPP))
    return _frames.task(setting, choices)


GROUP = Group(
    name="importance",
    title=f"The density that {_SPP} radii are drawn from",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    stands_for=("sampling.inverse_cdf.xie_pdf",),
)
