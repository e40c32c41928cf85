"""`drupe mat`: the marker mat as a PDF to print and the mat.json that describes it."""

import json
from pathlib import Path

from pipeline.layout import write_whole
from pipeline.paper import Paper
from recon.mat import mat_mapping, standard_mat, tag_bits
from reports.mat_sheet import mat_sheet_pdf


def write_mat(folder: Path, *, paper: Paper, cherry: bool) -> tuple[Path, Path]:
    """Writes mat.pdf and mat.json into `folder` and returns their paths; `cherry` halves tags and gaps."""
    mat = standard_mat(tag_mm=9.0, gap_mm=2.5, margin_mm=8.5) if cherry else standard_mat()
    bits = {tag: tag_bits(mat.dictionary, tag) for tag in mat.corners_mm}
    title = f"drupe marker mat, {mat.tag_mm:g} mm tags"
    pdf, mapping = folder / "mat.pdf", folder / "mat.json"
    write_whole(pdf, mat_sheet_pdf(mat.corners_mm, bits, sheet_mm=paper.size_mm, title=title))
    write_whole(mapping, json.dumps(mat_mapping(mat)) + "\n")
    return pdf, mapping
