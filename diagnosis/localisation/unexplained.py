"""Whether something is left that none of the effects explains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from bristle.diagnosis.estimation.fitted_model import LARGE_DISTURBANCE
from bristle.diagnosis.localisation.residual_localisation import OUTLIERS, SENSOR_VIEWS
from bristle.diagnosis.localisation.views import Share, is_form, is_same, periods_of
from bristle.diagnosis.report import result as answer
from bristle.plant.effects import effect as find_effect

LEAST_SHARE = 0.15  # share of the squared error that a view must explain before something is said to remain
CERTAIN_P = 0.03  # p over all views, from which on a share is believed
GAP_SHARE, WAVE_SHARE = 0.1, 0.05  # and of the error before, once an effect is named; a wave that repeats as the named one does
TONE_SHARE = (
    0.3  # of what is left, however small beside the gap: no effect's form swings in time (of 709 right names none had more)
)
LEAST_DRAWN_P, FAINT_SHARE = (
    0.001,
    0.05,
)  # p that no draw reaches: where nothing is named, such a share is enough then (1 more control of 240
# is flagged, 7 more of 240 records with an effect of no catalogue)
OUTLIER_SHARE = 0.08  # share that is enough where nothing is named and some stretch is far off
VIEW_ALONE_P = 0.05  # p of a view by itself, where the named wave should have taken up what is there


def unexplained(
    after: Sequence[Share],
    values: Mapping[str, float],
    named: Sequence[str],
    gap: answer.Gap,
    turn: float,
    fell: float,
    odd: bool = False,
    disturbance: float = 0.0,
) -> answer.Remains:
    """Say whether something is left that is neither small nor only the form of what was named.

    `fell` is the factor by which the error fell on segments kept from the search, none of them counting for much;
    with `odd` the model misses some stretch by far; `disturbance` is the torque that it takes for one, over that of the
    input: where nothing is named and this is large, there is more to it, whether a view shows it or not.
    What repeats as a multiple of a named wave is its form. What repeats as the wave itself, which was free to take it up,
    is something else, and evidence in that view alone is enough.
    """
    rattles = any(find_effect(name).coupling for name in named)  # no two runs of a loose load agree in each stretch
    seen = [share for share in after if share.view not in SENSOR_VIEWS and not (rattles and share.view == OUTLIERS)]
    waves = [periods for name in named if (periods := periods_of(name, values, turn)) is not None]
    left = gap.after / gap.before if gap.before > 0 else 1.0
    if named and fell < 1 and not rattles and not any(find_effect(name).sparse for name in named):
        return answer.Remains(True, seen[0].view, seen[0].share, disturbance, seen[0].label)
    certain = []
    for share in seen:
        same = any(is_same(share.periods, wave) for wave in waves)
        if not (share.p <= CERTAIN_P or (same and share.alone <= VIEW_ALONE_P)):
            continue
        certain.append(share)
        if named:
            beside = share.share * left >= (WAVE_SHARE if same else GAP_SHARE)
            large = share.share >= LEAST_SHARE and (beside or (share.view == "tone" and share.share >= TONE_SHARE))
        else:
            large = share.share >= (FAINT_SHARE if share.p <= LEAST_DRAWN_P else OUTLIER_SHARE if odd else LEAST_SHARE)
        if large and not any(is_form(share.periods, wave) for wave in waves):
            return answer.Remains(True, share.view, share.share, disturbance, share.label)
    first = (certain or after)[0]
    view, label = (first.view, first.label) if certain else (None, "")
    return answer.Remains(not named and disturbance > LARGE_DISTURBANCE, view, first.share, disturbance, label)
