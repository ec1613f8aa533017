"""One run as a video, or several in step: GIF, WebP or MP4, drawn without a display.

Pillow writes GIF and WebP, imageio-ffmpeg writes MP4. Every picture has its own robot, followed as
in the replay page, with the run's name and outcome above it. All are seen from the same direction,
and shown at the same time since the beginning of their logs; a run that is over stays where it
ended until the longest run is over.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from functools import cache, partial
from pathlib import Path

import matplotlib
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from aerodima.workbench.car.run_view import Progress
from aerodima.workbench.core.atomic_write import write_atomically
from aerodima.workbench.core.errors import UserError
from aerodima.workbench.core.extras import require
from aerodima.workbench.core.ranges import NO_UNIT, check_range
from aerodima.workbench.logs.schema import RunLog
from aerodima.workbench.view.captions import RESULT_COLOURS, run_caption, state_caption
from aerodima.workbench.view.offscreen import OffscreenRun
from aerodima.workbench.view.recording import check_rate, nearest_rows

FRAMES_PER_SECOND = 25
"""Frames per second of the video, whatever its rate."""
_REST = 1.0
"""Time for which the last frame stays, s."""
MAX_SECONDS = 120.0
"""Length of the longest video, s; it takes minutes of drawing for each run."""
MAX_RUNS = 6
"""Largest number of runs side by side."""
_ALONE = (640, 400)
"""Width and height of the picture of one run, pixels; even, as MP4 wants them."""
_TOGETHER = (480, 300)
"""Width and height of each picture of several runs, pixels; even, as MP4 wants them."""
_HEADER = 52
"""Height of the text above a picture, pixels."""
_GAP = 4
"""Width of the gap between two pictures, pixels."""
_INK = "#1c2430"
Encoder = Callable[..., None]
"""Function that writes a film to a path: `(path, film, progress)`."""


def write_video(
    runs: Mapping[str, RunLog],
    path: Path | str,
    *,
    force: bool = False,
    rate: float = 1.0,
    progress: Progress | None = None,
    start: float = 0.0,
) -> Path:
    """Writes runs as one video, side by side.

    Args:
        runs: logs of 1 to `MAX_RUNS` runs, by the name above the picture.
        path: path of the video, ending in .gif, .webp or .mp4.
        force: whether an existing file is replaced; it is refused otherwise.
        rate: seconds of the runs per second of the video; 0.25 is slow motion.
        progress: function that receives how many frames are drawn, and of how many.
        start: time after the beginning of the logs at which the video begins, s.

    Raises:
        UserError: wrong number of runs, ending, rate or start; encoder or renderer missing; the
            file exists or cannot be written.
        LogError: a run cannot be replayed, see `add_logged_run`.
    """
    path = Path(path)
    write = _encoder(path)
    check_rate(rate)
    check_range("--video: number of runs", len(runs), 1, MAX_RUNS, NO_UNIT)
    film = Film(runs, rate, start)
    return write_atomically(path, partial(write, film=film, progress=progress), force, UserError)


class Film:
    """The frames of a video."""

    def __init__(self, runs: Mapping[str, RunLog], rate: float, start: float = 0.0) -> None:
        """Plans the frames, see `write_video`; a video of more than `MAX_SECONDS` is refused."""
        whole = max(float(np.ptp(run_log.time)) for run_log in runs.values())
        if not 0.0 <= start < whole:
            raise UserError(
                f"--from {start:g}: must be 0 to below {whole:g} s, the length of the longest run"
            )
        longest = (whole - start) / rate
        check_range(f"--video: length at --rate {rate:g}", longest, 0.0, MAX_SECONDS, "s")
        self.number = math.ceil(longest * FRAMES_PER_SECOND - 1e-9) + 1
        since = start + np.arange(self.number) * rate / FRAMES_PER_SECOND
        self._panel = _ALONE if len(runs) == 1 else _TOGETHER
        self._columns = len(runs)
        if len(runs) > 3:
            self._columns = math.ceil(len(runs) / 2)
        self._shown = [OffscreenRun(run_log) for run_log in runs.values()]
        drawn = [shown.logged for shown in self._shown]
        self._rows = []
        self._headers = []
        for name, logged in zip(runs, drawn, strict=True):
            time = logged.run_log.time
            self._rows.append(nearest_rows(time, time[0] + since))
            self._headers.append(_header(name, logged.run_log, self._panel[0]))
        self._azimuth = float(np.median([logged.camera_azimuth for logged in drawn]))
        self._place = max(logged.camera_place for logged in drawn)

    @property
    def size(self) -> tuple[int, int]:
        """Gives width and height, pixels."""
        rows = math.ceil(len(self._shown) / self._columns)
        width = self._columns * (self._panel[0] + _GAP) - _GAP
        height = rows * (self._panel[1] + _HEADER + _GAP) - _GAP
        return width, height

    def frame(self, number: int) -> Image.Image:
        """Draws one frame, counted from 0."""
        picture = Image.new("RGB", self.size, "white")
        width, height = self._panel
        for index, header in enumerate(self._headers):
            down, across = divmod(index, self._columns)
            left = across * (width + _GAP)
            top = down * (height + _HEADER + _GAP)
            picture.paste(header, (left, top))
            picture.paste(self._panel_picture(index, number), (left, top + _HEADER))
        return picture

    def frames(self, progress: Progress | None) -> Iterator[Image.Image]:
        """Draws all frames; repeats the last one, which stays for `_REST`."""
        for number in range(self.number):
            last = self.frame(number)
            if progress is not None:
                progress(number + 1, self.number)
            yield last
        for _ in range(round(_REST * FRAMES_PER_SECOND)):
            yield last

    def _panel_picture(self, index: int, number: int) -> Image.Image:
        """Draws one run in a frame."""
        row = int(self._rows[index][number])
        shown = self._shown[index]
        picture = shown.picture(row, shown.camera(row, self._azimuth, self._place, self._panel))
        text = state_caption(shown.logged.run_log, row)
        ImageDraw.Draw(picture).text((10, self._panel[1] - 26), text, fill=_INK, font=_font(14))
        return picture


def _header(name: str, run_log: RunLog, width: int) -> Image.Image:
    """Writes name and outcome on white."""
    caption = run_caption(run_log)
    header = Image.new("RGB", (width, _HEADER), "white")
    draw = ImageDraw.Draw(header)
    draw.text((10, 4), name, fill=_INK, font=_font(18, bold=True))
    draw.text((10, 28), caption.outcome, fill=RESULT_COLOURS[caption.result], font=_font(15))
    return header


@cache
def _font(size: int, bold: bool = False) -> ImageFont.FreeTypeFont:
    """Opens the font that Matplotlib brings."""
    name = f"DejaVuSans{'-Bold' if bold else ''}.ttf"
    return ImageFont.truetype(str(Path(matplotlib.get_data_path(), "fonts", "ttf", name)), size)


def _encoder(path: Path) -> Encoder:
    """Chooses an encoder by the ending; UserError for an unknown ending, or if the encoder is
    missing.
    """
    ending = path.suffix.lower()
    if ending not in _ENCODERS:
        raise UserError(f"--video {path}: ending {path.suffix!r}; must be {', '.join(_ENCODERS)}")
    if ending == ".mp4":
        require("video", f"--video {path}, which may also be .webp or .gif", "imageio_ffmpeg")
    return _ENCODERS[ending]


def _write_gif(path: Path, film: Film, progress: Progress | None) -> None:
    """Uses one palette for all frames and no dithering, so that what stands still costs nothing."""
    numbers = sorted({0, film.number // 2, film.number - 1})
    sample = np.concatenate([np.asarray(film.frame(number)) for number in numbers])
    palette = Image.fromarray(sample).quantize(256)
    dither = Image.Dither.NONE
    frames = (frame.quantize(palette=palette, dither=dither) for frame in film.frames(progress))
    _save(path, frames, format="GIF", optimize=False)


def _write_webp(path: Path, film: Film, progress: Progress | None) -> None:
    """Compresses with loss."""
    _save(path, film.frames(progress), format="WEBP", quality=60, method=2)


def _save(path: Path, frames: Iterator[Image.Image], **how: object) -> None:
    first = next(frames)
    milliseconds = round(1000 / FRAMES_PER_SECOND)
    first.save(path, save_all=True, append_images=frames, duration=milliseconds, loop=0, **how)  # type: ignore[arg-type]


def _write_mp4(path: Path, film: Film, progress: Progress | None) -> None:
    import imageio_ffmpeg

    writer = imageio_ffmpeg.write_frames(
        str(path),
        film.size,
        fps=FRAMES_PER_SECOND,
        macro_block_size=2,
        quality=7,
        output_params=["-f", "mp4"],  # the path is a temporary one, with another ending
    )
    writer.send(None)
    with closing(writer):
        for frame in film.frames(progress):
            writer.send(frame.tobytes())


_ENCODERS: dict[str, Encoder] = {".mp4": _write_mp4, ".gif": _write_gif, ".webp": _write_webp}
