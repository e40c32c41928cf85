"""batch.toml is read strictly, and every fault is said with its key."""

import os

import pytest

from pipeline.batch.settings_file import MOST_BYTES, read_settings
from pipeline.problem import BatchRefused


def refusals(tmp_path, text):
    path = tmp_path / "batch.toml"
    path.write_text(text)
    with pytest.raises(BatchRefused) as caught:
        read_settings(path)
    return [str(p) for p in caught.value.problems]


def test_only_the_category_is_required(tmp_path):
    path = tmp_path / "batch.toml"
    path.write_text('category = "plum"\n')
    assert read_settings(path).category == "plum"


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
    lines = refusals(tmp_path, "poisson_ratio = 0.7\nnonsense = 1\n")
    assert len(lines) == 3


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
    path = tmp_path / "batch.toml"
    for coin, diameter_mm in (
        ('coin = "1 euro"', 23.25),
        ("coin_mm = 24.26", 24.26),
        ('coin = "1 Euro"', 23.25),
    ):
        path.write_text(f'category = "plum"\n[photos]\n{coin}\n')
        assert read_settings(path).photos.scale.diameter_mm == diameter_mm
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
        (
            "[grading]\ncertainty = 0.4\n",
            '"grading.certainty": found 0.4; expected 0.5 or more',
        ),
        ("[grading]\ncertainty = 90\n", "is it in per cent (0.9)?"),
        (
            "[grading]\ninspect_below_p = 5\n",
            "expected at most 1: is it in per cent (0.05)?",
        ),
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
    path = tmp_path / "batch.toml"
    path.write_text('category = "plum"\nlot = "a\\u001b[31mb\\u202ec"\n')
    assert read_settings(path).lot == "a[31mbc"


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
