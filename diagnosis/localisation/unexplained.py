"""Whether a part of the residual is unexplained: predictable from the motion, and not the form of
an effect that was named.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from bristle.diagnosis.answer import CERTAIN_P, MIN_SHARE, OUTLIERS, SENSOR_VIEWS, Unexplained
from bristle.diagnosis.estimation.fitted_model import LARGE_DISTURBANCE
from bristle.diagnosis.localisation.views import Share, is_form, is_same, periods_of
from bristle.plant.effects import effect as find_effect

# p of a view by itself up to which its wave is taken for real, where a named effect has the same
# period
VIEW_ALONE_P = 0.05
# share of the residual that is reported where nothing is named: views predict up to that of what a
# slow disturbance and few counts leave
SHARE_WITHOUT_NAME = 0.2
MIN_SHARE_OF_GAP = 0.1  # share of the error before, once an effect is named
SAME_WAVE_SHARE_OF_GAP = 0.05  # the same for a wave with the period of the named effect
# share of the residual of an oscillation in time, however small beside the error before
TONE_SHARE = 0.3


@dataclass(frozen=True)
class FinalModel:
    """What the rules need to know of the model that the search ended with."""

    named: Sequence[str] = ()  # effects
    values: Mapping[str, float] = field(default_factory=dict)  # its parameters [SI]
    turn: float = 6.283185307179586  # path along which periods are counted [rad or m]
    # mean squared error of all segments, over that of the model without effects
    error_left: float = 1.0
    # factor by which that of held-out ones falls, with the influence of single segments bounded
    error_fall: float = 1.0
    disturbance: float = 0.0  # as of `Unexplained`

    @property
    def free_play(self) -> bool:
        """Whether a named effect is a load with free play: its segments may diverge by chance."""
        return any(find_effect(name).coupling for name in self.named)

    @property
    def waves(self) -> list[float]:
        """How often the named effects that repeat do so along the path."""
        periods = (periods_of(name, self.values, self.turn) for name in self.named)
        return [each for each in periods if each is not None]

    @property
    def ineffective(self) -> bool:
        """Whether effects were named that do not lower the error on held-out segments, although
        they act in all of them.
        """
        everywhere = not self.free_play and not any(find_effect(name).sparse for name in self.named)
        return bool(self.named) and self.error_fall < 1 and everywhere


def unexplained(shares: Sequence[Share], model: FinalModel) -> Unexplained:
    """Return whether a part of the residual is unexplained; `shares` are those of the final model,
    the largest first.

    A multiple of a named wave is its form. The named wave itself, which was free to fit, is
    something else, and evidence in that view alone is enough. Where nothing is named, no view shows
    much and the fit needs a large disturbance, that is what acts.
    """
    unseen = (*SENSOR_VIEWS, OUTLIERS) if model.free_play else SENSOR_VIEWS
    seen = [each for each in shares if each.view not in unseen]
    if model.ineffective:
        first = seen[0]
        return Unexplained(True, first.view, first.share, model.disturbance, first.label)
    # what is certain, and the first of it that is large and no form of what is named
    certain = []
    for share in seen:
        same = any(is_same(share.periods, wave) for wave in model.waves)
        if not (share.p <= CERTAIN_P or (same and share.alone <= VIEW_ALONE_P)):
            continue
        certain.append(share)
        form = any(is_form(share.periods, wave) for wave in model.waves)
        if _is_large(share, model, same) and not form:
            found = Unexplained(True, share.view, share.share, model.disturbance, share.label)
            return replace(found, doubtful=_of_gap(share, model, same))
    # else the largest share that is certain, or that of no view
    disturbed = not model.named and model.disturbance > LARGE_DISTURBANCE
    rest = Unexplained(False, None, shares[0].share, model.disturbance, disturbed=disturbed)
    if not certain:
        return rest
    return replace(rest, view=certain[0].view, share=certain[0].share, label=certain[0].label)


def _is_large(share: Share, model: FinalModel, same: bool) -> bool:
    """Return whether a share is large enough to report; `same`: its period is a named effect's."""
    if not model.named:
        return share.share >= SHARE_WITHOUT_NAME
    tone = share.view == "tone" and share.share >= TONE_SHARE
    return share.share >= MIN_SHARE and (tone or _of_gap(share, model, same))


def _of_gap(share: Share, model: FinalModel, same: bool) -> bool:
    """Return whether a share is large beside the error before."""
    least = SAME_WAVE_SHARE_OF_GAP if same else MIN_SHARE_OF_GAP
    return share.share * model.error_left >= least
