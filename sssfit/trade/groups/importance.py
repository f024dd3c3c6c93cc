"""Which density draws the radius of a sample, and whether its difference from the profile is weighed."""

from sssfit.sampling import inverse_cdf
from sssfit.trade.choice import Group, Task
from sssfit.trade.groups import _frames
from sssfit.trade.setting import Setting

_QUICK = ("log_poly12", "log_linear", "xie", "mixture")


def _prepare(setting: Setting) -> Task:
    methods = _QUICK if setting.is_quick else inverse_cdf.METHODS
    names = {name: {"importance": name, "corrected": True} for name in methods}
    names["xie, uncorrected"] = {"importance": "xie", "corrected": False}
    return _frames.task(setting, _frames.varied(setting, setting.settings, names))


GROUP = Group(
    name="importance",
    title=f"The density that {_frames.SPP} radii are drawn from",
    unit="pixel",
    error=_frames.ERROR,
    reference=_frames.REFERENCE,
    prepare=_prepare,
    stands_for=("sampling.inverse_cdf.xie_pdf",),
)
