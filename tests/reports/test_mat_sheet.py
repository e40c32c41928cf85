import re
import zlib

import numpy as np
import pytest
from matplotlib.path import Path

from reports.mat_sheet import mat_sheet_pdf, tag_outline

POINTS_PER_MM = 72.0 / 25.4
SHEET_MM = (210.0, 297.0)


def square(x, y, side):
    h = side / 2
    return np.array([(x - h, y + h, 0), (x + h, y + h, 0), (x + h, y - h, 0), (x - h, y - h, 0)], float)


@pytest.fixture
def corners():
    centres = [(x, y) for y in (60.0, 0.0, -60.0) for x in (-60.0, 0.0, 60.0) if (x, y) != (0.0, 0.0)]
    return {tag: square(x, y, 20.0) for tag, (x, y) in enumerate(centres)}


@pytest.fixture
def bits(corners):
    rng = np.random.default_rng(7)
    return {tag: np.pad(rng.random((6, 6)) < 0.5, 1) for tag in corners}


def made(corners, bits):
    return mat_sheet_pdf(corners, bits, sheet_mm=SHEET_MM, title="a mat")


def drawn(pdf):
    """The page's drawing operators."""
    for stream in re.findall(rb"stream\r?\n(.*?)\r?\nendstream", pdf, re.DOTALL):
        try:
            text = zlib.decompress(stream).decode("latin-1")
        except zlib.error:
            continue
        if re.search(r"^[\d.-]+ [\d.-]+ m$", text, re.MULTILINE):
            return text
    raise AssertionError("no drawing found")


def paths_mm(pdf):
    """Corner points of each filled path, mm from the sheet's centre."""
    paths = []
    for block in re.split(r"\n(?:f|b|B|S|s|n|f\*)\n", drawn(pdf)):
        points = re.findall(r"^([\d.-]+) ([\d.-]+) [ml]$", block, re.MULTILINE)
        if points:
            paths.append(np.array(points, float) / POINTS_PER_MM - np.array(SHEET_MM) / 2)
    return paths


def test_page_is_the_sheet_at_true_size(corners, bits):
    box = re.search(rb"/MediaBox \[ 0 0 ([\d.]+) ([\d.]+) \]", made(corners, bits))
    assert np.array(box.groups(), float) / POINTS_PER_MM == pytest.approx(SHEET_MM, abs=1e-3)


def test_tags_are_vectors_at_their_places(corners, bits):
    paths = paths_mm(made(corners, bits))
    for placed in corners.values():
        assert any(
            np.allclose(path.min(0), placed[:, :2].min(0), atol=1e-3)
            and np.allclose(path.max(0), placed[:, :2].max(0), atol=1e-3)
            for path in paths
        )


def test_bar_is_100_mm_long(corners, bits):
    widths = [np.ptp(path[:, 0]) for path in paths_mm(made(corners, bits)) if path[:, 1].max() < -72.0]
    assert max(widths) == pytest.approx(100.0, abs=1e-3)


def test_same_mat_gives_the_same_bytes_without_a_date(corners, bits):
    pdf = made(corners, bits)
    assert pdf == made(corners, bits)
    assert b"Date" not in pdf


def test_outline_is_black_exactly_where_the_cells_are():
    rng = np.random.default_rng(1)
    for _ in range(20):
        cells = rng.random((8, 8)) < 0.5
        outline = tag_outline(square(3.0, -5.0, 16.0), cells)
        rows, columns = np.mgrid[:8, :8]
        centres = np.stack([3.0 - 8.0 + 2.0 * (columns + 0.5), -5.0 + 8.0 - 2.0 * (rows + 0.5)], axis=2)
        area, black = 0.0, np.zeros(64, int)
        for loop in outline.to_polygons(closed_only=True):
            turn = np.sum(loop[:-1, 0] * loop[1:, 1] - loop[1:, 0] * loop[:-1, 1]) / 2
            area += turn
            inside = Path(loop).contains_points(centres.reshape(-1, 2))
            black += np.where(inside, int(np.sign(turn)), 0)
        assert abs(area) == pytest.approx(4.0 * np.count_nonzero(~cells))
        assert (np.abs(black.reshape(8, 8)) == (~cells).astype(int)).all()


def test_sheet_too_small_is_refused_with_both_sizes(corners, bits):
    with pytest.raises(ValueError, match=r"needs a sheet of 140 x 178 mm .* is 150 x 150 mm"):
        mat_sheet_pdf(corners, bits, sheet_mm=(150.0, 150.0), title="")


def test_tag_without_cells_and_mat_without_tags_are_refused(corners, bits):
    del bits[3]
    with pytest.raises(ValueError, match="tag 3"):
        made(corners, bits)
    with pytest.raises(ValueError, match="no tags"):
        made({}, {})
