"""Pictures are drawn without a window, and films are files that open."""

import numpy as np
import pytest
from PIL import Image

from frasa_rl.render import Camera, RenderError, save_film
from frasa_rl.standup_env import StandUp
from frasa_sysid.calibration import UsageError

FRAMES = [np.full((12, 16, 3), shade, dtype=np.uint8) for shade in (0, 80, 160, 240)]


def test_the_robot_is_drawn(nominal):
    """rgb_array gives a picture in which the robot stands out from the ground."""
    env = StandUp(nominal, render_mode="rgb_array")
    env.reset(seed=0)
    try:
        picture = env.render()
    except RenderError as error:
        pytest.skip(f"this machine cannot draw: {error}")
    finally:
        env.close()
    assert picture.shape == (360, 480, 3)
    assert picture.dtype == np.uint8
    assert picture.std() > 10


def test_without_opengl_the_message_says_what_to_install(env, monkeypatch):
    """A machine without OpenGL gets one clear line, not a traceback of a GL library."""

    def broken(*_):
        raise ImportError("no EGL")

    monkeypatch.setattr("mujoco.Renderer", broken)
    with pytest.raises(RenderError, match="MUJOCO_GL=egl"):
        Camera(env.model)


@pytest.mark.parametrize("suffix", [".gif", ".webp"])
def test_an_animation_has_all_pictures(tmp_path, suffix):
    """An animated file holds every picture, at its frame time."""
    path = tmp_path / f"film{suffix}"
    save_film(FRAMES, path, 20.0)
    with Image.open(path) as film:
        assert film.n_frames == 4
        assert film.size == (16, 12)


def test_a_png_is_a_strip(tmp_path):
    """A png shows evenly spaced pictures side by side, the first and the last among them."""
    path = tmp_path / "film.png"
    save_film(FRAMES, path, 20.0, strip=3)
    strip = np.asarray(Image.open(path))
    assert strip.shape == (12, 48, 3)
    assert strip[0, 0, 0] == 0
    assert strip[0, -1, 0] == 240


def test_other_formats_are_refused(tmp_path):
    """A format that cannot be written is refused with those that can."""
    with pytest.raises(UsageError, match=r"\.gif"):
        save_film(FRAMES, tmp_path / "film.mp4", 20.0)
