"""Pictures of a simulation, without a window, and animated files of them."""

import io
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import numpy.typing as npt

from frasa_sysid.calibration import FrasaError, UsageError, write_atomic

Frame = npt.NDArray[np.uint8]
FORMATS = (".gif", ".webp", ".png")


class RenderError(FrasaError):
    """This machine cannot draw."""


class Camera:
    """A camera that follows the trunk from the side.

    Args:
        model: what is drawn.
        trunk: body it follows.
        width, height: of the picture [pixel].
        distance: from the trunk [m].
        azimuth: from which side [deg]; 90 is from the robot's right, as it begins.

    Raises:
        RenderError: no OpenGL without a window on this machine.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        trunk: str = "trunk",
        width: int = 480,
        height: int = 360,
        distance: float = 1.1,
        azimuth: float = 120.0,
    ) -> None:
        # The model's off-screen buffer may be smaller than the picture.
        model.vis.global_.offwidth = max(model.vis.global_.offwidth, width)
        model.vis.global_.offheight = max(model.vis.global_.offheight, height)
        self._renderer = _renderer(model, height, width)
        for flag in (mujoco.mjtRndFlag.mjRND_SHADOW, mujoco.mjtRndFlag.mjRND_REFLECTION):
            self._renderer.scene.flags[flag] = False  # most of the time of a software renderer
        self._view = mujoco.MjvCamera()
        self._view.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        self._view.trackbodyid = model.body(trunk).id
        self._view.distance, self._view.azimuth, self._view.elevation = distance, azimuth, -12.0

    def picture(self, data: mujoco.MjData) -> Frame:
        """The scene now, shape (height, width, 3)."""
        self._renderer.update_scene(data, self._view)
        picture: Frame = self._renderer.render().copy()
        return picture

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def check_drawing() -> None:
    """Say early when nothing can be drawn: before a trial is simulated for its pictures.

    Raises:
        RenderError: no OpenGL without a window on this machine.
    """
    _renderer(mujoco.MjSpec().compile(), 8, 8).close()


def _renderer(model: mujoco.MjModel, height: int, width: int) -> mujoco.Renderer:
    try:
        return mujoco.Renderer(model, height, width)
    except Exception as error:  # the GL back ends raise many kinds, from three libraries
        raise RenderError(
            f"cannot draw without a window ({type(error).__name__}: {error}); "
            "install libegl1 and set MUJOCO_GL=egl, or libosmesa6 and MUJOCO_GL=osmesa"
        ) from None


def check_format(path: Path) -> None:
    """Say early when a film cannot be written in the format its name asks for.

    Raises:
        UsageError: another suffix than those of `FORMATS`.
    """
    if path.suffix.lower() not in FORMATS:
        raise UsageError(f"cannot write {path}: a film is one of {', '.join(FORMATS)} (png: one strip of pictures)")


def save_film(frames: Sequence[Frame], path: Path, frames_per_s: float, strip: int = 8) -> None:
    """Write an animation (.gif, .webp), or a strip of `strip` evenly spaced pictures side by side (.png).

    The file is complete or as it was before.
    """
    from PIL import Image  # an optional dependency, needed only here

    check_format(path)
    content = io.BytesIO()
    if path.suffix.lower() == ".png":
        chosen = np.linspace(0, len(frames) - 1, min(strip, len(frames))).round().astype(int)
        Image.fromarray(np.concatenate([frames[i] for i in chosen], axis=1)).save(content, "PNG")
    else:
        images = [Image.fromarray(frame) for frame in frames]
        images[0].save(
            content,
            path.suffix[1:].upper(),
            save_all=True,
            append_images=images[1:],
            duration=round(1000.0 / frames_per_s),
            loop=0,
        )
    write_atomic(path, content.getvalue())
