"""Trials as strips of pictures on a page: what a controller does, at a glance."""

import io

from frasa_rl.controllers import Controller
from frasa_rl.film import Film, Shots, film_push, film_standup
from frasa_rl.page_parts import reason
from frasa_rl.protocol import SIDES, Conditions
from frasa_rl.push_rig import DIRECTIONS
from frasa_sysid.calibration import FrasaError
from frasa_sysid.calibration.figures import image_of
from frasa_sysid.calibration.page import Html, join, tag

_SHOTS = Shots(count=8, width=300, height=320, more_s=0.15)
_QUALITY = 82  # of WebP: a strip takes some 50 kB


def standup_strips(controller: Controller, conditions: Conditions) -> Html:
    """The first stand-up trial from each side; one sentence where this machine cannot draw."""
    strips = []
    for side in SIDES:
        try:
            film = film_standup(controller, conditions, side, shots=_SHOTS)
        except FrasaError as error:
            return reason(error)
        ending = "does not stand up" if film.time_s is None else f"stands up in {film.time_s:.2f} s"
        strips += [tag("h3", f"From {side}: {ending}"), strip(film)]
    return join(strips)


def push_strip(controller: Controller, conditions: Conditions) -> Html:
    """The first trial of the strongest push in front; one sentence where this machine cannot draw."""
    cell = DIRECTIONS[0], conditions.task.rig.energies_j[-1]
    try:
        film = film_push(controller, conditions, cell, shots=_SHOTS)
    except FrasaError as error:
        return reason(error)
    ending = "is not stable again" if film.time_s is None else f"is stable again after {film.time_s:.2f} s"
    title = (
        f"Pushed from the {cell[0]} with {cell[1]:.1f} J: {ending if film.stood else 'did not stand before the push'}"
    )
    return join([tag("h3", title), strip(film)])


def strip(film: Film) -> Html:
    """The pictures of a film beside each other, each with its time."""
    from PIL import Image  # comes with matplotlib, without which there is no page

    figures = []
    for frame, time_s in zip(film.frames, film.times_s, strict=True):
        content = io.BytesIO()
        Image.fromarray(frame).save(content, "WEBP", quality=_QUALITY)
        caption = f"{time_s:.2f} s"
        figures.append(tag("figure", image_of(content.getvalue(), "webp", caption), tag("figcaption", caption)))
    return tag("div", *figures, css="strip")
