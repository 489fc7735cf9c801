import pytest

pytest.importorskip("matplotlib")

from frasa_sysid.evidence import Estimate
from frasa_sysid.report_verdicts import estimate_figure, half_width, kind_of, verdict_figure

VERDICTS = ("identified", "known roughly", "only in combination with mx106.damping_off", "not excited", "on its bound")


def estimate(name="mx106.kp", value=20.0, half=0.1, unit="N m/rad", verdict="identified"):
    return Estimate(name, unit, value, 18.0, value - half, value + half, verdict, "")


@pytest.mark.parametrize(
    ("one", "words"),
    [
        (estimate(), "± 0.5 %"),
        (estimate(value=-20.0), "± 0.5 %"),
        (estimate(value=0.1, half=0.15), "± 150 %"),
        (estimate(value=0.01, half=0.5, unit="N m"), "± 0.5 N m"),
        (estimate(value=0.0, half=0.25, unit="N m"), "± 0.2 N m"),
        (estimate(value=0.008, half=0.0003, unit="s"), "± 0.3 ms"),
        (estimate(half=1.0, verdict="not excited"), "unknown"),
        (estimate(value=0.013, half=0.0021, unit="rad"), "± 2.1 mrad"),
    ],
)
def test_half_widths(one, words):
    """Shares where the number has a scale, its own unit where it has none."""
    assert half_width(one) == words


def test_every_verdict_has_a_colour():
    """All kinds of verdicts are told apart, one that names a partner among them."""
    kinds = [kind_of(one) for one in VERDICTS]
    assert len(set(kinds)) == len(VERDICTS)
    cases = {"all": [estimate(f"mx106.p{i}", verdict=one) for i, one in enumerate(VERDICTS)], "few": [estimate()]}
    figure = verdict_figure(cases)
    ax = figure.axes[0]
    assert [text.get_text() for text in ax.get_yticklabels()] == [*(f"mx106.p{i}" for i in range(5)), "mx106.kp"]
    assert len({patch.get_facecolor() for patch in ax.patches}) == len(VERDICTS)
    assert len(ax.patches) == 6  # a number that a fit has not is left out


def test_estimates_show_interval_truth_and_verdict():
    """Each panel has the intervals of all fits, hollow where not identified, and the truth where it is known."""
    cases = {
        "m1": [estimate(), estimate("mx106.delay", 0.008, 0.0004, "s", "known roughly")],
        "m4": [estimate(value=21.0)],
    }
    figure = estimate_figure(cases, {"mx106.kp": 20.5})
    kp, delay = (ax for ax in figure.axes if ax.get_visible())
    lines = {line.get_label(): line for line in kp.lines}
    assert list(lines["truth"].get_xdata()) == [20.5, 20.5]
    spans = [tuple(line.get_xdata()) for line in kp.lines if len(line.get_xdata()) == 2 and line is not lines["truth"]]
    assert spans == [(19.9, 20.1), (20.9, 21.1)]
    assert delay.get_xlabel() == "ms"
    dots = [line for line in delay.lines if len(line.get_xdata()) == 1]
    assert [dot.get_markerfacecolor() for dot in dots] == ["white"]
    assert all(line.get_label() != "truth" for line in delay.lines)
    assert len([ax for ax in estimate_figure(cases, names=["mx106.kp"]).axes if ax.get_visible()]) == 1
