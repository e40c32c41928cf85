"""A batch's settings: what is missing or impossible is named, with the slip that it likely is."""

import os
import time
import tomllib

import numpy as np
import pytest
from small_batches import batch_of_balls, write_ball

from pipeline.batch.fruits_table import FruitRow
from pipeline.batch.opening import open_batch, survey
from pipeline.batch.plausible_numbers import grading_doubts, kind_of, mesh_doubt, row_doubts, table_doubts
from pipeline.batch.settings import Grading, GradingClass
from pipeline.batch.settings_file import MOST_BYTES, read_settings
from pipeline.files.plain_file import NotReadable, _line_of_deep_key, toml_of
from pipeline.problem import BatchRefused
from pipeline.run.checking import check, implausible
from recon.pit.priors import load_prior
from recon.silhouettes.hull import ball
from recon.surface.mesh_file import write_mesh


def settings_of(tmp_path, text):
    path = tmp_path / "batch.toml"
    path.write_text(text)
    return read_settings(path)


def refusals(tmp_path, text):
    with pytest.raises(BatchRefused) as caught:
        settings_of(tmp_path, text)
    return [str(p) for p in caught.value.problems]


def test_only_the_category_is_required(tmp_path):
    assert settings_of(tmp_path, 'category = "plum"\n').category == "plum"


def test_what_is_missing_is_named(tmp_path):
    for path, said in (
        ("batch.toml", r"batch\.toml: does not exist"),
        ("nowhere/batch.toml", "does not exist; give an"),
    ):
        with pytest.raises(BatchRefused, match=said):
            read_settings(tmp_path / path)


@pytest.mark.parametrize("table", ["sensor", "gripper", "pit", "recon", "mesh", "flesh", "grading"])
def test_unknown_key_is_named_in_every_table(tmp_path, table):
    lines = refusals(tmp_path, f'category = "plum"\n[{table}]\nnonsense = 1\n')
    assert any(f'unknown key "{table}.nonsense"' in line for line in lines)


def test_all_faults_are_said_at_once(tmp_path):
    assert len(refusals(tmp_path, "poisson_ratio = 0.7\nnonsense = 1\n")) == 3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("poisson_ratio = 0,45  # assumed\n", "line 2 has a decimal comma: write 0.45."),
        ("poisson_ratio = ,45\n", "line 2 has a decimal comma: write 0.45."),
        ("[photos]\ncoin_mm=23,25", "line 3 has a decimal comma: write 23.25."),
        (
            '[grading]\nclasses = [{name = "ripe", E_max_MPa = 0,4}, {name = "firm"}]\n',
            "line 3 has a decimal comma: write 0.4.",
        ),
        (
            'poisson_ratio = "0,45"\n',
            "\"poisson_ratio\": found '0,45'; expected a number, without quotes; it has a decimal comma; "
            "write 0.45.",
        ),
    ],
)
def test_a_decimal_comma_is_called_one(tmp_path, text, says):
    (line,) = refusals(tmp_path, f'category = "plum"\n{text}')
    assert line.endswith(f"batch.toml: {says}")


def test_only_a_text_in_another_encoding_is_told_to_be_saved_as_utf_8(tmp_path):
    for text, column in (('category = "plum\nlot = "0,45"\n', 17), ('lot = "E=0,45\n', 14)):
        (line,) = refusals(tmp_path, text)
        assert line.endswith(f"(at line 1, column {column}); correct it there.")
    (tmp_path / "batch.toml").write_bytes('category = "plum"\nlot = "Müller"\n'.encode("latin-1"))
    with pytest.raises(BatchRefused, match=r"line 2\); save it again as UTF-8 text"):
        read_settings(tmp_path / "batch.toml")
    (tmp_path / "batch.toml").write_text('category = "plum"\n' + "#" * MOST_BYTES)
    with pytest.raises(BatchRefused, match=r"larger than 1 MB, the most that is read\.$"):
        read_settings(tmp_path / "batch.toml")


def test_a_coin_is_known_by_name_or_given_by_its_diameter(tmp_path):
    for coin, diameter_mm in (
        ('coin = "1 euro"', 23.25),
        ("coin_mm = 24.26", 24.26),
        ('coin = "1 Euro"', 23.25),
    ):
        settings = settings_of(tmp_path, f'category = "plum"\n[photos]\n{coin}\n')
        assert settings.photos.scale.diameter_mm == diameter_mm
    (said,) = refusals(tmp_path, 'category = "plum"\n[photos]\ncoin = "1 eur"\n')
    assert '"photos.coin": found' in said
    assert 'drupe knows no coin "1 eur"; did you mean "1 euro"? known:' in said
    assert "2 euro (25.75 mm)" in said
    assert ".." not in said
    (said,) = refusals(tmp_path, 'category = "plum"\n[photos]\ncoin = "1 euro"\ncoin_mm = 23.25\n')
    assert "not both" in said


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("category = ", "is not valid TOML"),
        ('cultivr = "x"\n', 'unknown key "cultivr"; did you mean "cultivar"?'),
        ('[pit]\nprio = "plum"\n', 'unknown key "pit.prio"; did you mean "prior"?'),
        ("poisson_ratio = 0.5\n", '"poisson_ratio": found 0.5'),
        ("[mesh]\nedge_mm = -1\n", '"mesh.edge_mm": found -1'),
        ('[[grading.classes]]\nname = "a"\nE_max_MPa = 1.0\n', "must have no E_max_MPa"),
        ("[grading]\ncertainty = 0.4\n", '"grading.certainty": found 0.4; expected 0.5 or more'),
        ("[grading]\ncertainty = 90\n", "is it in per cent (0.9)?"),
        ("[grading]\ninspect_below_p = 5\n", "expected at most 1: is it in per cent (0.05)?"),
        (
            '[[grading.classes]]\nname = "a"\nE_max_MPa = 1.0\n'
            '[[grading.classes]]\nname = "b"\nE_max_MPa = 0.5\n[[grading.classes]]\nname = "c"\n',
            'must grow from class to class; found 0.5 for "b" after 1 for "a".',
        ),
        (
            '[[grading.classes]]\nname = "a"\n[[grading.classes]]\nname = "b"\n',
            'E_max_MPa of class "a" is missing; only the last (firmest) class may omit it',
        ),
        ("pulp_temperature_C = 293\n", "expected at most 50: is it in kelvin (19.9 C)?"),
        ("pulp_temperature_C = 68\n", "expected at most 50: is it in Fahrenheit (20.0 C)?"),
        ("poisson_ratio = 45\n", "is it in per cent (0.45)?"),
        ("poisson_ratio = nan\n", "expected a finite number"),
        (
            '[sensor]\nname = "x"\ngel_scale_sd = 1e300\n',
            '"sensor.gel_scale_sd": found 1e+300; expected at most 0.5',
        ),
        ("[pit]\nsize_sd = 5\n", '"pit.size_sd": found 5; expected at most 0.5: is it in per cent (0.05)?'),
        ("poisson_ratio = 0\n", '"poisson_ratio": found 0; expected 0.1 or more'),
        ("[pit]\nsize_sd = 1e-300\n", '"pit.size_sd": found 1e-300; expected 0.0001 or more'),
        ("[pit]\noffset_sd_mm = 1e-300\n", '"pit.offset_sd_mm": found 1e-300; expected 0.001 or more'),
        (
            '[sensor]\nname = "x"\nforce_scale_sd = 1e-300\n',
            '"sensor.force_scale_sd": found 1e-300; expected',
        ),
        ('[sensor]\nname = "x"\npose_sd_mm = 1e-300\n', '"sensor.pose_sd_mm": found 1e-300; expected 0.001'),
        ("[pit]\nsize_sd = inf\n", "expected a finite number"),
        ("[pit]\noffset_sd_mm = true\n", '"pit.offset_sd_mm"'),
        ('cultivar = ["a"]\n', "\"cultivar\": found ['a']; expected a text in quotes"),
        ("harvest_date = 2206-08-14\n", "expected at most 2100-01-01"),
        ("photos = 3\n", '"photos": found 3; expected a table'),
        ("cultivar = 12\n", "expected a text in quotes"),
        ('notes = "' + "x" * 20_000 + '"\n', "longer than 10000 characters"),
        ('lot = "' + "桃" * 201 + '"\n', "longer than 200 characters"),
        ("a = " + "[" * 5000 + "]" * 5000 + "\n", "nested too deep"),
        ("a = " + "1" * 5000 + "\n", "number of thousands of digits"),
        ("a = " + "1" * 400 + "\n", "a whole number beyond 64 bits"),
        (".".join("a" * 9000) + " = 1\n", "nested too deep"),
        ('lot = "' + "x" * 2_000_000 + '"\n', "larger than 1 MB"),
    ],
)
def test_faults_of_settings_are_said_in_plain_words_with_key_and_expectation(tmp_path, text, says):
    lines = refusals(tmp_path, f'category = "plum"\n{text}')
    assert any(says in line for line in lines), lines
    for line in lines:
        assert "Input should" not in line
        assert len(line) < 500


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("/dev/zero", "is a device, not a file"),
        ("gone.toml", "is a link to nothing"),
        ("batch.toml", "is a link that leads back to itself"),
        ("pipe", "is a named pipe, not a file"),
    ],
)
def test_what_is_no_file_is_never_opened(tmp_path, target, said):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "batch.toml").symlink_to(target)
    with pytest.raises(BatchRefused, match=said):
        read_settings(tmp_path / "batch.toml")


def test_text_reaches_nobody_with_control_characters(tmp_path):
    assert settings_of(tmp_path, 'category = "plum"\nlot = "a\\u001b[31mb\\u202ec"\n').lot == "a[31mbc"


def test_a_fault_in_a_list_of_tables_names_the_entry_and_its_line(tmp_path):
    classes = 'category = "plum"\n\n[[grading.classes]]\nname = "ripe"\nE_max_MPa = -1\n'
    (negative,) = refusals(tmp_path, f"{classes}[[grading.classes]]\nname = 'firm'\n")
    assert '"grading.classes[1].E_max_MPa" ("ripe", line 3): found -1' in negative
    (nameless,) = refusals(tmp_path, 'category = "plum"\n[[grading.classes]]\nship = true\n')
    assert 'the required key "grading.classes[1].name" (line 2) is missing' in nameless
    (inline,) = refusals(tmp_path, 'category = "plum"\n[grading]\nclasses = [{name = "a", x = 1}]\n')
    assert 'unknown key "grading.classes[1].x";' in inline
    text = 'notes = """\n[[grading.classes]]\n"""'
    (no_table,) = refusals(tmp_path, f'category = "plum"\n{text}\n[grading]\nclasses = [5]\n')
    assert '"grading.classes[1]": found 5; expected a table' in no_table
    (after_text,) = refusals(tmp_path, f"{text}\n{classes}")  # which of the two headers it is nobody knows
    assert '"grading.classes[1].E_max_MPa": found -1' in after_text


NECTARINE = kind_of(load_prior("nectarine"))
SOUND = {"height_mm": 55.3, "diameter_mm": 61.5, "mass_g": 112.0, "shore_oo": 69.0}


def doubts(kind=NECTARINE, **changed):
    return list(row_doubts(FruitRow(fruit_id="A", **{**SOUND, **changed}), kind))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"height_mm": 5.53}, "height_mm 5.53: a nectarine is 25 to 105 mm high; is it in cm (55.3 mm)?"),
        ({"height_mm": 2.16}, "is it in inches (54.86 mm)?"),
        ({"height_mm": 0.0553}, "is it in m (55.3 mm)?"),
        ({"height_mm": 553}, "is its decimal point missing (55.3 mm)?"),
        ({"height_mm": 1e300}, "height_mm 1e+300: a nectarine is 25 to 105 mm high; correct it."),
        ({"diameter_mm": 6.15}, "diameter_mm 6.15: a nectarine is 35 to 115 mm wide; is it in cm (61.5 mm)?"),
        ({"mass_g": 0.112}, "mass_g 0.112: a nectarine is 18 to 650 g in mass; is it in kg (112 g)?"),
        ({"mass_g": 3.95}, "is it in ounces (112 g)?"),
        ({"shore_oo": 580}, "is its decimal point missing (58)?"),
        ({"shore_oo": 0.58}, "is it a share of 1 (58)?"),
        ({"mass_g": 20.0}, "together they give a density of 0.18 g per cm3, but a nectarine has 0.55 to 1.8"),
        ({"diameter_mm": 112, "mass_g": 61.5}, "Check whether two are swapped"),
    ],
)
def test_the_likely_slip_is_named(changed, said):
    (sentence,) = doubts(**changed)
    assert said in sentence


@pytest.mark.parametrize("category", ["nectarine", "peach", "plum", "apricot", "cherry", "phantom"])
def test_fruit_of_every_size_and_shape_of_their_kind_pass(category):
    kind = kind_of(load_prior(category))
    rng = np.random.default_rng(1)
    for _ in range(300):
        # Sizes of the category's own fruit_mm, shapes to 1.45, densities of flesh: not of the ranges tested.
        size = rng.uniform(*load_prior(category).fruit_mm)
        ratio = rng.uniform(1 / 1.45, 1.45)
        height, wide = size * ratio ** (2 / 3), size * ratio ** (-1 / 3)
        mass = np.pi / 6000 * height * wide**2 * rng.uniform(0.9, 1.25)
        fair = all(
            low <= v <= high
            for v, (low, high) in ((height, kind.ranges.height_mm), (wide, kind.ranges.diameter_mm))
        )
        if fair:
            assert doubts(kind, height_mm=height, diameter_mm=wide, mass_g=mass) == []


def test_a_whole_column_in_cm_is_one_sentence_and_not_one_for_each_fruit():
    rows = tuple(FruitRow(fruit_id=str(i), height_mm=5.5 + 0.1 * i, mass_g=110.0) for i in range(5))
    (said,) = table_doubts(rows, NECTARINE).values()
    assert said.startswith("height_mm of all 5 fruit is 5.5 to 5.9; a nectarine is 25 to 105 mm high")
    assert "is it in cm (57 mm)?" in said
    assert list(row_doubts(rows[0], NECTARINE, said={"height_mm"})) == []


def test_limits_in_kilopascal_are_said():
    classes = (GradingClass(name="soft", E_max_MPa=300), GradingClass(name="firm"))
    (said,) = grading_doubts(Grading(classes=classes), NECTARINE)
    assert 'E_max_MPa of "soft" is 300' in said
    assert "is it in kPa (0.3 MPa)?" in said
    fine = (GradingClass(name="soft", E_max_MPa=0.3), GradingClass(name="firm"))
    assert list(grading_doubts(Grading(classes=fine), NECTARINE)) == []


@pytest.mark.parametrize(
    ("factor", "said"),
    [
        (
            0.001,
            "the mesh measures 0.061 x 0.059 x 0.055 mm; a nectarine is 25 to 115 mm in size; is it in m "
            "(61 mm)?",
        ),
        (0.1, "is it in cm"),
        (1 / 25.4, "is it in inches"),
        (1000, "is it in µm"),
    ],
)
def test_a_mesh_in_another_unit_is_said(factor, said):
    box = np.array([61.0, 59.0, 55.0]) * factor
    assert said in mesh_doubt(box, NECTARINE)
    assert mesh_doubt(box / factor, NECTARINE) == ""
    assert mesh_doubt(box, kind_of(None)) == ""


@pytest.fixture
def batch(tmp_path):
    table = "fruit_id,height_mm,mass_g\nA,55.9,90\nB,55.9,90\n"
    return batch_of_balls(tmp_path, "A", "B", table=table)


def said(root):
    return "\n".join(str(p).replace(f"{root}/", "") for p in check(root))


def test_one_fruit_costs_itself_and_a_column_costs_the_batch_unless_forced(batch):
    (batch / "fruits.csv").write_text("fruit_id,height_mm,mass_g\nA,5.59,90\nB,55.9,90\n")
    opened = open_batch(batch)
    assert [bool(implausible(opened, row)) for row in opened.rows] == [True, False]
    (batch / "fruits.csv").write_text("fruit_id,height_mm,mass_g\nA,5.59,90\nB,5.59,90\n")
    with pytest.raises(BatchRefused, match="height_mm of all 2 fruit is 5"):
        open_batch(batch)
    assert open_batch(batch, force=True).rows[0].height_mm == 5.59


def test_a_mesh_in_metres_is_the_first_and_only_thing_said_of_it(batch):
    write_ball(batch / "fruits" / "A" / "fruit.ply", radius_mm=0.028)
    lines = [line for line in said(batch).splitlines() if "A/fruit.ply" in line]
    (line,) = lines
    assert "is it in m (" in line
    assert "flesh" not in line


def test_category_table_and_numbers_are_said_in_one_go(batch):
    (batch / "batch.toml").write_text(
        'category = "nectarine"\npulp_temperature_C = 68\n[[grading.classes]]\nname = "soft"\n'
        'E_max_MPa = 300\n[[grading.classes]]\nname = "firm"\n'
    )
    (batch / "fruits.csv").write_text("fruit_id;height_mm;mass_g\nA;5,59;90\nB;55,9;90\n")
    (batch / "fruits" / "B" / "fruit.ply").write_bytes(b"no mesh")
    text = said(batch)
    for words in (
        "is it in Fahrenheit (20.0 C)?",
        "is it in kPa (0.3 MPa)?",
        "A: height_mm 5.59: a nectarine is 25 to 105 mm high; is it in cm",
        "B/fruit.ply is broken",
    ):
        assert words in text


def test_two_bodies_are_no_fruit(batch):
    directions, faces = ball(3)
    two = np.concatenate([28 * directions, 28 * directions + [80, 0, 0]])
    write_mesh(batch / "fruits" / "A" / "fruit.ply", two, np.concatenate([faces, faces + len(directions)]))
    assert "2 separate surfaces; expected one closed surface" in said(batch)


def test_numbers_are_never_said_twice(batch):
    (batch / "fruits.csv").write_text("fruit_id,height_mm,mass_g\nA,5.59,90\nB,55.9,90\n")
    assert said(batch).count("5.59") == 1
    assert survey(batch).problems == ()


DEEP = (
    '"!".' * 20 + "a = 1",
    "'!' . " * 20 + "a = 1",
    "a-1.\t" * 20 + "a = 1",
    "[" + '"\\"".' * 20 + "a]",
    "[[" + "'='." * 20 + "a]]",
    "a = { " + '"!".' * 20 + "a = 1 }",
    'a = [1.5, "]", { x.y = 1, ' + "a." * 20 + "b = 1 }]",
    'a = """\n"" \\""" ""\n"""\n' + "a." * 20 + "b = 1",
    "a = '''\n'' \\'''\n" + "a." * 20 + "b = 1",
    "# a.b\n\n" + "a." * 20 + "b = 1",
)
"""TOML with a key of 21 parts."""
SHALLOW = (
    "# " + "a." * 90,
    'a = "' + "a." * 90 + '"',
    "a = '" + "a." * 90 + "'",
    'a = """\n' + "a." * 90 + '\n" "" \\""" ' + "a." * 90 + '"""""',
    "a = '''\n" + '"a".' * 90 + "'''''",
    "a = [" + "1.5, " * 90 + "]",
    "a = ['" + "x', '." * 90 + "']",
    "\n".join(f"a{k}.b.c = 1.5" for k in range(90)),
    "a." * 19 + "b = 1",
    '"' + "." * 90 + '" = 1',
)
"""TOML with many dots and a key of 20 parts at most."""


@pytest.mark.parametrize("text", DEEP)
def test_a_key_of_21_parts_is_refused_wherever_it_is_and_its_line_is_named(text):
    line = text.count("\n") + 1
    with pytest.raises(NotReadable, match=f"line {line} holds a key of more than 20 parts"):
        toml_of(text)


@pytest.mark.parametrize("text", SHALLOW)
def test_other_dots_are_read_as_the_standard_library_reads_them(text):
    assert toml_of(text) == tomllib.loads(text)


@pytest.mark.parametrize(
    "part", ['"', "'", "'''", '"""', '\\"""', "a.", '"a".', "a.\n", "[", "#", ". ", '"\\', "a.b=1\n"]
)
def test_the_search_for_deep_keys_takes_time_in_proportion_to_the_text(part):
    """300 kB in 2 s; with the square of the text it would be hours."""
    for before in ("", '"""', "'''"):
        began = time.process_time()
        _line_of_deep_key(before + part * (300_000 // len(part)))
        assert time.process_time() - began < 2


def survey_said(folder, text):
    (folder / "batch.toml").write_text(f'category = "nectarine"\n{text}')
    return [problem.sentence for problem in survey(folder).problems if "batch.toml" in problem.file]


@pytest.mark.parametrize(
    ("providers", "sentence"),
    [
        (
            '["X"]',
            '"recon.providers": found "X"; expected names of ONNX Runtime\'s providers: this machine has',
        ),
        (
            '["CUDAExecutionProvidr", "CPUExecutionProvider"]',
            'found "CUDAExecutionProvidr"; expected names of ONNX Runtime\'s providers: did you mean '
            "CUDAExecutionProvider?",
        ),
        ("[]", '"recon.providers": found an empty list; expected one that this machine has: '),
        ('["RknpuExecutionProvider"]', "found RknpuExecutionProvider; expected one that this machine has: "),
    ],
)
def test_a_provider_that_models_cannot_run_on_is_refused(tmp_path, providers, sentence):
    (sentence_found,) = survey_said(tmp_path, f"[recon]\nproviders = {providers}\n")
    assert sentence in sentence_found


def test_providers_that_another_machine_has_may_stand_before_one_that_this_has(tmp_path):
    text = '[recon]\nproviders = ["CUDAExecutionProvider", "CPUExecutionProvider"]\n'
    assert survey_said(tmp_path, text) == []
