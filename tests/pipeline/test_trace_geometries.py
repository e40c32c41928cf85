"""`drupe convert` and `drupe explain` on punches and plates: what is asked for, kept, and made of it."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
from small_batches import run

from tactile.readers.recording import IndenterPad, read_recording, write_recording

CYLINDER = ("--indenter", "plates", "--specimen", "cylinder", "--height-mm", "12", "--diameter-mm", "15")
FRUIT = ("--indenter", "plates", "--diameters-mm", "61", "60", "58", "--axis", "c")
OILED = (*CYLINDER, "--ends", "lubricated")
RUBBER = 'category = "rubber"\npoisson_ratio = 0.499\n'
E_MPA = 0.4


def pressed(path, force_of, deepest_mm, *, noise=0.001, step=1):
    """A ramp after some frames in the air, and a hold; noise as a share of the peak. `step`: of frames."""
    travel = np.r_[np.zeros(30), np.linspace(0, deepest_mm + 0.1, 90), np.full(40, deepest_mm + 0.1)][::step]
    force = force_of(np.maximum(travel - 0.1, 0.0))
    force = force + noise * force.max() * np.random.default_rng(2).standard_normal(len(force))
    rows = np.column_stack([np.arange(len(travel)) * step / 10, travel, force])
    np.savetxt(path, rows, delimiter=",", header="time_s,travel_mm,force_N", comments="")
    return path


@pytest.fixture
def source(tmp_path):
    return pressed(tmp_path / "t.csv", sliding_N, 3.0)


@pytest.fixture
def case(tmp_path):
    (tmp_path / "case").mkdir()
    return tmp_path / "case"


def tip_of(path):
    pad = read_recording(path).pads[0]
    assert isinstance(pad, IndenterPad)
    return pad


def explained(folder, case, *sources, options):
    made = folder / "case"
    made.mkdir()
    (made / "case.toml").write_text(case)
    for k, source in enumerate(sources):
        code, said = run("convert", source, made / f"press-{k + 1}.h5", *options)
        assert code == 0, said
    code, said = run("explain", made, "--json", folder / "answer.json", "--html", folder / "page.html")
    assert code == 0, said
    return json.loads((folder / "answer.json").read_text())


def sliding_N(depth):
    """Treloar's incompressible cylinder of 15 x 12 mm between oiled plates."""
    left = 1 - depth / 12
    return E_MPA * np.pi * 15**2 / 4 * (left**-2 - left) / 3


def test_a_cylinder_between_oiled_plates_gives_its_modulus(source, tmp_path):
    answer = explained(tmp_path, RUBBER, source, options=OILED)
    assert answer["verdict"] == "none"
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    assert any("taken as sliding" in note for note in answer["notes"])
    assert "cylinder 15 mm wide, 12 mm high" in (tmp_path / "page.html").read_text()


def test_a_punch_gives_boussinesqs_modulus_and_says_what_it_cannot_look_for(tmp_path):
    source = pressed(tmp_path / "t.csv", lambda d: 2 * 3.0 * E_MPA / (1 - 0.45**2) * d, 0.5)
    punch = ("--indenter", "flat", "--radius-mm", "3")
    answer = explained(tmp_path, 'category = "silicone"\npoisson_ratio = 0.45\n', source, options=punch)
    assert answer["verdict"] == "none"
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    assert any(note.startswith("Stiffening was not looked for") for note in answer["notes"])
    assert {"stiffening", "damage"}.isdisjoint(hypothesis["effect"] for hypothesis in answer["ranking"])


def test_the_specimen_is_kept_in_the_recording(source, tmp_path):
    for k, options in enumerate(((*FRUIT, "--pit-share", "0"), (*CYLINDER, "--ends", "bonded"))):
        assert run("convert", source, tmp_path / f"{k}.h5", *options)[0] == 0
    fruit, cylinder = (tip_of(tmp_path / f"{k}.h5") for k in range(2))
    assert (fruit.indenter, fruit.radius_mm) == ("plate", None)
    assert fruit.specimen.stated == {"diameters_mm": (61.0, 60.0, 58.0), "axis": "c", "pit_share": 0.0}
    sizes = {"height_mm": 12.0, "diameter_mm": 15.0}
    assert cylinder.specimen.stated == {"kind": "cylinder", **sizes, "ends": "bonded"}


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--indenter", "flat"), "ball or flat with --radius-mm"),
        (("--indenter", "plates", "--radius-mm", "3"), "--radius-mm is the radius of a ball or punch"),
        (("--indenter", "plates"), "give --specimen cylinder with --height-mm 12"),
        (CYLINDER[:-2], "does not fully describe the cylinder between the plates; give --diameter-mm"),
        (("--indenter", "plate", "--specimen", "fruit", "--axis", "a"), "give --diameters-mm 61 60 58"),
        ((*FRUIT, "--ends", "bonded"), "gives --ends for a fruit, which has only --specimen, --diameters-mm"),
        (("--indenter", "ball", "--radius-mm", "3", "--height-mm", "4"), "gives --height-mm for a ball on"),
        (("--indenter", "flat", "--radius-mm", "9", "--thickness-mm", "2"), "radius 9 mm on 2 mm of flesh"),
        (("--indenter", "plates", "--diameters-mm", "90", "60", "40", "--axis", "c"), "more than 1.6 times"),
    ],
)
def test_what_is_missing_or_strange_is_asked_for_before_a_file_is_written(source, tmp_path, options, words):
    code, said = run("convert", source, tmp_path / "out.h5", *options)
    assert code == 1
    assert words in " ".join(said.split())
    assert not (tmp_path / "out.h5").exists()


@pytest.mark.proof
def test_an_older_files_plate_is_explained_once_the_case_says_what_was_between(source, case):
    """Files of before have a radius and no specimen."""
    assert run("convert", source, case / "old.h5", *OILED)[0] == 0
    with h5py.File(case / "old.h5", "a") as file:
        pad = file["pads/tip"].attrs
        for name in ("specimen", "height_mm", "diameter_mm", "ends"):
            del pad[name]
        pad["radius_mm"] = 5.0
    (case / "case.toml").write_text('category = "rubber"\npoisson_ratio = 0.45\n')
    code, said = run("explain", case)
    assert code == 1
    assert (
        "old.h5: does not name the specimen between the plates; give specimen cylinder with height_mm 12"
        in said
    )
    (case / "case.toml").write_text(
        'category = "rubber"\npoisson_ratio = 0.45\nspecimen = "cylinder"\nheight_mm = 12\n'
        'diameter_mm = 15\nends = "lubricated"\n'
    )
    assert run("explain", case)[0] == 0


def test_a_fruit_takes_its_categorys_pit_and_says_so(tmp_path):
    source = pressed(tmp_path / "t.csv", lambda d: 0.9 * d**1.5, 4.0)
    answer = explained(
        tmp_path, 'category = "nectarine"\naxis = "b"\n', source, options=(*FRUIT, "--category", "nectarine")
    )
    notes = " ".join(answer["notes"])
    assert "drupe uses the category's pit, 0.44 of the fruit's diameter" in notes
    assert "axis is c in the recording but b in case.toml; drupe uses the latter" in notes
    assert "The fruit's shape" in notes
    assert "squeezed along 60 mm" in (tmp_path / "page.html").read_text()


@pytest.mark.slow
def test_a_curve_of_another_specimen_is_named_by_its_file_and_left_out(tmp_path):
    """The third cylinder is 1.5 times as stiff as the others."""
    stiffer = (1.0, 1.0, 1.5, 1.0)
    sources = [
        pressed(tmp_path / f"{k}.csv", lambda d, times=times: times * sliding_N(d), 2.0, step=2)
        for k, times in enumerate(stiffer)
    ]
    answer = explained(tmp_path, RUBBER, *sources, options=OILED)
    assert answer["left_out"] == ["press-3"]
    said = "Recording 3 (press-3) does not belong to the others"
    assert answer["notes"][0].startswith(said)
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    page = (tmp_path / "page.html").read_text()
    assert said in page
    assert "nominal: it assumes" in page
    assert answer["p_nominal"].startswith("nominal")


@pytest.mark.proof
def test_three_recordings_of_one_specimen_have_one_modulus_and_their_own_first_touch(tmp_path):
    sources = [pressed(tmp_path / f"{k}.csv", sliding_N, 2.0 + 0.5 * k) for k in range(3)]
    answer = explained(tmp_path, RUBBER, *sources, options=OILED)
    assert answer["verdict"] == "none"
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    assert {f"onset_mm{end}" for end in ("", "_2", "_3")} <= answer["ranking"][0]["parameters"].keys()
    assert any(note.startswith("Recording 3 (press-3): First touch 0.099") for note in answer["notes"])


def test_two_bare_jaws_are_two_plates_with_the_mean_of_their_forces(source, case, tmp_path):
    (case / "case.toml").write_text(RUBBER)
    assert run("convert", source, case / "one.h5", *OILED)[0] == 0
    press = read_recording(case / "one.h5")
    tip = tip_of(case / "one.h5")
    jaws = [
        replace(tip, name=name, force_z_N=k * tip.force_z_N) for name, k in (("left", 0.9), ("right", 1.1))
    ]
    grasp = replace(
        press, loading="grasp", support="free", aperture_mm=12.1 - press.aperture_mm, pads=tuple(jaws)
    )
    (case / "one.h5").unlink()
    write_recording(case / "jaws.h5", grasp)
    assert run("explain", case, "--json", tmp_path / "a.json")[0] == 0
    answer = json.loads((tmp_path / "a.json").read_text())
    assert answer["E_MPa"]["after"]["value"] == pytest.approx(E_MPA, rel=0.02)
    write_recording(
        case / "jaws.h5", replace(grasp, pads=(jaws[0], replace(jaws[1], indenter="flat", radius_mm=3.0)))
    )
    assert "has two bare pads, plate and flat" in run("explain", case)[1]


def test_a_shape_without_a_law_is_refused_by_explain_as_well(source, case):
    (case / "case.toml").write_text('category = "rubber"\npoisson_ratio = 0.45\nheight_mm = 1.5\n')
    assert run("convert", source, case / "one.h5", *CYLINDER, "--ends", "bonded")[0] == 0
    code, said = run("explain", case)
    assert code == 3
    assert "height 0.1 diameters, expected 0.25 to 3" in " ".join(said.split())
