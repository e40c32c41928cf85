"""Frames of a resized camera, resized again so that their pixels are square.

Markers are detected and tracked by distances in pixels, which mean the same along x and y only in square
pixels. A picture that was squeezed into another shape has two focal lengths. The direction with fewer pixels
per millimetre is stretched to match the other, and the camera with it.
"""

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import UInt8

from tactile.gel_camera import has_square_pixels
from tactile.readers.raw_grasp import RawCamera, RawGrasp, RawPad
from tactile.sensors import GelCamera


def with_square_pixels(raw: RawGrasp) -> RawGrasp:
    """The same grasp; frames, references and cameras of resized pictures have square pixels."""
    return replace(raw, pads=tuple(map(_squared, raw.pads)))


def _squared(pad: RawPad) -> RawPad:
    first, second = pad.sensor.camera, pad.sensor.second_camera
    sensor = replace(
        pad.sensor,
        camera=None if first is None else square_camera(first),
        second_camera=None if second is None else square_camera(second),
    )
    return replace(
        pad,
        sensor=sensor,
        view=_seen_by(first, pad.view),
        second=None if pad.second is None else _seen_by(second, pad.second),
    )


def square_camera(camera: GelCamera) -> GelCamera:
    """The camera of the stretched picture, whose pixels are square to half a pixel of its size."""
    if has_square_pixels(camera):
        return camera
    focal, size = np.array(camera.focal_px), np.array(camera.image_px)
    stretched = np.rint(size * focal.max() / focal).astype(int)
    fx, fy = (focal * stretched / size).tolist()
    cx, cy = ((np.array(camera.centre_px) + 0.5) * stretched / size - 0.5).tolist()
    width, height = stretched.tolist()
    return replace(camera, image_px=(width, height), focal_px=(fx, fy), centre_px=(cx, cy))


def _seen_by(camera: GelCamera | None, view: RawCamera) -> RawCamera:
    """The pictures of this camera with square pixels; those of another size stay, and a later check refuses
    them."""
    if camera is None or (square := square_camera(camera)) is camera:
        return view

    def stretched(picture: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "a b 3"]:
        if picture.shape[1::-1] != camera.image_px:
            return picture
        return np.asarray(cv2.resize(picture, square.image_px, interpolation=cv2.INTER_LINEAR), np.uint8)

    pictures = replace(view.pictures, frames=lambda: map(stretched, view.pictures.frames()))
    return replace(view, reference=stretched(view.reference), pictures=pictures)
