"""`drupe mat`: the marker mat as a PDF to print and the mat.json that describes it."""

import json
from functools import partial
from pathlib import Path

from pipeline.batch.write_guard import require_new_or_ours
from pipeline.files.whole_file import put
from recon.cameras.printed_mat import mat_mapping, standard_mat, tag_bits
from reports.mat_sheet import mat_sheet_pdf


def write_mat(folder: Path, *, sheet_mm: tuple[float, float], cherry: bool) -> tuple[Path, Path]:
    """Writes mat.pdf, for a sheet of this width and height, and mat.json into `folder`; `cherry` halves tags
    and gaps.

    Raises BatchRefused where a file of that name has other content: batches are read by their mat.json.
    """
    mat = standard_mat(tag_mm=9.0, gap_mm=2.5, margin_mm=8.5) if cherry else standard_mat()
    bits = {tag: tag_bits(mat.dictionary, tag) for tag in mat.corners_mm}
    title = f"drupe marker mat, {mat.tag_mm:g} mm tags"
    pdf, mapping = folder / "mat.pdf", folder / "mat.json"
    sheet = mat_sheet_pdf(mat.corners_mm, bits, sheet_mm=sheet_mm, title=title)
    content = {pdf: sheet, mapping: (json.dumps(mat_mapping(mat)) + "\n").encode()}
    for path, data in content.items():
        require_new_or_ours(path, partial(_holds, data=data), f"this mat's {path.name}")
    for path, data in content.items():
        put(path, data)
    return pdf, mapping


def _holds(path: Path, *, data: bytes) -> bool:
    try:
        return path.stat().st_size == len(data) and path.read_bytes() == data
    except OSError:
        return False
