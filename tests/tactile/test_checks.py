"""A sound recording passes every check; each mistake of the field made on it is named by its cause.

The recording is tests/data/nectarine-grasp: another solver's, with noise, on a scanned mesh (SOURCE.md).
"""

import re
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from recon.pit.priors import load_prior
from recon.surface.mesh_file import read_mesh
from samples.fruit import fruits_of_seed, scanned_mesh
from tactile.checks.channels import noise_findings
from tactile.checks.finding import Finding, FindingKind, FindingRank, shared
from tactile.checks.footprint import Footprint, better_otherwise
from tactile.checks.gel_law import MOST_FOR_SLAB, displacement_of
from tactile.checks.lattice import is_thinned, missing_sites
from tactile.checks.of_recording import QUARTERS, recording_findings
from tactile.checks.pressing import noise_shares, pressing_of
from tactile.checks.relation import relation_of
from tactile.checks.relation_findings import relation_findings
from tactile.checks.time_order import dropped_steps
from tactile.checks.units import FORCE, unit_like
from tactile.gel.force_inverse import InvertedForce
from tactile.gel.force_prior import INITIAL_HYPERPARAMETERS
from tactile.gel.grid import gel_grid
from tactile.gel.slab import GelSlab, tent_compliance
from tactile.io.recording import GelPad, read_recording

DATA = Path(__file__).parents[1] / "data" / "nectarine-grasp"
SHIPPED = Path(__file__).parents[2] / "samples" / "data" / "nectarines"
RANGE_MPA = load_prior("nectarine").plausible.E_MPa


@pytest.fixture(scope="module")
def sound():
    return read_recording(DATA / "grasp.h5"), read_mesh(DATA / "fruit.ply")


def findings(recording, mesh):
    return recording_findings(recording, *mesh, E_range_MPa=RANGE_MPA)


def on_pads(change, only=None):
    def changed(recording):
        pads = [change(pad) if only in (None, pad.name) else pad for pad in recording.pads]
        return replace(recording, pads=tuple(pads))

    return changed


def force(times, only=None):
    return on_pads(lambda pad: replace(pad, force_N=pad.force_N * times), only)


def shift(times, only=None):
    return on_pads(lambda pad: replace(pad, displacement_mm=pad.displacement_mm * times), only)


def both(change):
    return on_pads(
        lambda pad: replace(
            pad, force_N=change(pad.force_N.copy()), displacement_mm=change(pad.displacement_mm.copy())
        )
    )


def delayed(values, frames):
    return values[np.clip(np.arange(len(values)) - frames, 0, None)]


def picked(n, share=0.3):
    return np.random.default_rng(5).random(n) < share


def spoilt(start, value):
    def change(values):
        who = picked(values.shape[1])
        values[start:, who] = value if value is not None else values[start, who]
        return values

    return both(change)


def clipped(values):
    out = values.copy()
    out[:, :, 2] = np.minimum(out[:, :, 2], 0.5 * out[:, :, 2].max())
    return out


def without(choose):
    def change(pad):
        k = ~choose(pad)
        return replace(
            pad, rest_mm=pad.rest_mm[k], force_N=pad.force_N[:, k], displacement_mm=pad.displacement_mm[:, k]
        )

    return on_pads(change)


def in_order(log):
    def change(recording):
        k = np.random.default_rng(3).permutation(len(recording.time_s))
        changed = both(lambda values: values[k])(recording)
        if log:
            changed = on_pads(lambda pad: replace(pad, pose=pad.pose[k]))(changed)
            changed = replace(changed, aperture_mm=changed.aperture_mm[k])
        return changed

    return change


def one_zero_frame(values):
    values[30] = 0.0
    return values


def permuted(field):
    order = np.random.default_rng(4).permutation(400)
    if field == "rest_mm":
        return on_pads(lambda pad: replace(pad, rest_mm=pad.rest_mm[order]))
    return on_pads(lambda pad: replace(pad, **{field: getattr(pad, field)[:, order]}))


def poses(change):
    return on_pads(lambda pad: replace(pad, pose=change(pad.pose.copy())))


def in_metres(pose):
    pose[:, :3, 3] *= 1e-3
    return pose


def transposed(pose):
    pose[:, :3, :3] = np.swapaxes(pose[:, :3, :3], 1, 2)
    return pose


def gel(times):
    return on_pads(lambda pad: replace(pad, gel_kn_MPa_per_mm=pad.gel_kn_MPa_per_mm * times))


def drifting(recording):
    time = recording.time_s
    grown = 1.8 * (time - time[0])[:, None] / (time[-1] - time[0]) / 400
    left, right = recording.pads
    force = left.force_N.copy()
    force[:, :, 2] += grown
    return replace(recording, pads=(replace(left, force_N=force), right))


def dropped(recording):
    return kept(np.flatnonzero(np.arange(len(recording.time_s)) % 3 != 2))(recording)


def kept(frames):
    def change(recording):
        pads = tuple(
            replace(
                pad,
                pose=pad.pose[frames],
                force_N=pad.force_N[frames],
                displacement_mm=pad.displacement_mm[frames],
            )
            for pad in recording.pads
        )
        cut = {"time_s": recording.time_s[frames], "aperture_mm": recording.aperture_mm[frames]}
        return replace(recording, pads=pads, **cut)

    return change


def noisy(times):
    def change(pad):
        rng = np.random.default_rng(7)
        more = np.sqrt(times**2 - 1)
        return replace(
            pad,
            displacement_mm=pad.displacement_mm + rng.normal(0, 0.004 * more, pad.force_N.shape),
            force_N=pad.force_N + rng.normal(0, 0.005 * more, pad.force_N.shape),
        )

    return on_pads(change)


REFUSED = {
    "grams": (force(101.97), "look like grams"),
    "kilonewtons": (force(1e-3), "look like kilonewtons"),
    "one pad in grams": (force(101.97, "left"), "the left pad's forces look like grams"),
    "one pad halved": (force(0.5, "right"), "the right pad's forces are 0.50 times"),
    "force sign": (force(-1.0), "force has the wrong sign"),
    "force clipped": (on_pads(lambda p: replace(p, force_N=clipped(p.force_N))), "is clipped"),
    "force late": (on_pads(lambda p: replace(p, force_N=delayed(p.force_N, 5))), "5 frames late"),
    "force x and z": (on_pads(lambda p: replace(p, force_N=p.force_N[..., ::-1])), "force has its axes"),
    "force permuted": (permuted("force_N"), "permuted"),
    "metres": (shift(1e-3), "displacement looks like metres"),
    "displacement halved": (shift(0.5), "a scale of the displacement"),
    "displacement sign": (shift(-1.0), "displacement has the wrong sign"),
    "displacement x and z": (
        on_pads(lambda p: replace(p, displacement_mm=p.displacement_mm[..., ::-1])),
        "displacement has its axes",
    ),
    "displacement permuted": (permuted("displacement_mm"), "permuted"),
    "displacement dead": (shift(0.0, "left"), "the left pad's displacement is dead"),
    "increments": (
        on_pads(lambda p: replace(p, displacement_mm=np.diff(p.displacement_mm, axis=0, prepend=0.0))),
        "increments",
    ),
    "rest permuted": (permuted("rest_mm"), "permuted"),
    "markers missing": (without(lambda pad: picked(len(pad.rest_mm))), "grid has holes"),
    "every second marker missing": (
        without(lambda pad: np.arange(len(pad.rest_mm)) % 2 == 1),
        "both pads' markers are only every second one of the gel: about 200 of 400 are missing",
    ),
    "every second marker missing, in turns": (
        without(lambda pad: np.indices((20, 20)).sum(axis=0).ravel() % 2 == 1),
        "both pads' markers are only every second one of the gel: about 200 of 400 are missing",
    ),
    "every third marker kept": (
        without(lambda pad: np.arange(len(pad.rest_mm)) % 3 != 1),
        "both pads' markers are only every third one of the gel",
    ),
    "half of the gel missing": (without(lambda pad: pad.rest_mm[:, 0] > 0.2), "markers are missing"),
    "zero throughout": (spoilt(0, 0.0), "are zero in displacement and force"),
    "zero from the middle": (spoilt(28, 0.0), "are zero in displacement and force"),
    "frozen": (spoilt(24, None), "are frozen in displacement and force"),
    "a frame of zeros": (both(one_zero_frame), "zero at every marker in 1 frames"),
    "gel's frames shuffled": (in_order(log=False), "shuffled"),
    "all frames shuffled": (in_order(log=True), "shuffled"),
    "poses in metres": (poses(in_metres), "poses look like metres"),
    "poses transposed": (poses(transposed), "transposed"),
    "poses of one instant": (poses(lambda pose: np.tile(pose[0], (len(pose), 1, 1))), "poses stand still"),
    "stiffness in kPa": (gel(1e3), "kPa/mm"),
}
SAID = {
    "a gain of 1.2": (force(1.2), "forces are 1.20 times"),
    "a drift": (drifting, "the left pad's force drifts"),
    "aperture in cm": (lambda r: replace(r, aperture_mm=r.aperture_mm / 10), "aperture_mm looks like cent"),
    "every third frame dropped": (dropped, "frames were dropped: "),
    "ten times the noise": (noisy(10.0), "mostly noise"),
    "no first touch": (kept(slice(22, None)), "starts in contact"),
}


def test_a_sound_recording_passes(sound):
    assert findings(*sound) == []


@pytest.mark.parametrize("number", [1, 2, 3, 4])
def test_the_shipped_sample_passes_on_its_scans(number):
    fruit = fruits_of_seed(4, seed=1)[number - 1]
    mesh = scanned_mesh(fruit, cells=28, error_mm=0.1)
    for path in sorted((SHIPPED / "fruits" / fruit.fruit_id / "grasps").glob("*.h5")):
        assert findings(read_recording(path), mesh) == [], path


@pytest.mark.parametrize("mistake", REFUSED)
def test_a_mistake_is_refused_and_its_cause_stands_first(sound, mistake):
    change, words = REFUSED[mistake]
    recording, mesh = sound
    found = findings(change(recording), mesh)
    assert found
    assert found[0].refused
    assert words in found[0].sentence


@pytest.mark.parametrize("mistake", SAID)
def test_a_mild_mistake_is_said_and_leaves_the_recording_of_use(sound, mistake):
    change, words = SAID[mistake]
    recording, mesh = sound
    found = findings(change(recording), mesh)
    assert any(words in one.sentence for one in found)
    assert not any(one.refused for one in found)


@pytest.mark.parametrize("side", [lambda p: p.rest_mm[:, 0] > 0.2, lambda p: p.rest_mm[:, 1] < 0.0])
def test_half_of_the_gel_missing_is_refused_without_a_mesh_too(sound, side):
    """As `drupe check` meets a photographed fruit, whose mesh nobody has yet."""
    recording, _ = sound
    assert findings(recording, (None, None)) == []
    first, *_ = findings(without(side)(recording), (None, None))
    assert (first.kind, first.refused) == (FindingKind.OVER_EDGE, True)
    assert "the force beyond them is missing; markers are missing" in first.sentence


def test_a_cut_gel_of_both_pads_is_said_once(sound):
    recording, mesh = sound
    for choose in (lambda p: p.rest_mm[:, 0] > 0.2, lambda p: picked(len(p.rest_mm))):
        (one,) = findings(without(choose)(recording), mesh)
        assert one.sentence.startswith("both pads' ")


def test_a_gain_of_a_half_on_a_whole_grid_is_a_gain_and_missing_markers_are_one_cause_named(sound):
    recording, mesh = sound
    first, *_ = findings(force(0.5)(recording), mesh)
    assert first.kind is FindingKind.GAIN
    assert first.sentence.endswith("or only one of every 2 markers is in the arrays")


@pytest.mark.parametrize("turn_deg", [0, 90])
def test_a_whole_grid_is_not_thinned(turn_deg):
    line = np.arange(9.0)
    square = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    hexagonal = square @ np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    rng, angle = np.random.default_rng(2), np.radians(turn_deg)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    for grid in (square, hexagonal):
        placed = (grid + rng.normal(0, 0.03, grid.shape)) @ turn
        assert not is_thinned(placed)
        assert is_thinned(placed[::3])


def test_the_same_fault_of_both_pads_is_one_finding_whatever_its_numbers(sound):
    recording, mesh = sound
    left, right = (on_pads(lambda p: replace(p, force_N=p.force_N[..., ::-1]), n) for n in ("left", "right"))
    (one,) = findings(left(recording), mesh)
    (both,) = findings(right(left(recording)), mesh)
    assert (one.kind, one.field, one.pads) == (FindingKind.AXES, "force", ("left",))
    assert (both.kind, both.field, both.pads) == (FindingKind.AXES, "force", ("left", "right"))
    assert both.sentence.startswith("both pads' force has its axes")


def test_findings_are_told_apart_by_kind_field_and_detail_and_not_by_words():
    def found(pad, kind=FindingKind.DELAY, field=None, detail="5", says="as it is"):
        return Finding(
            kind=kind, rank=FindingRank.RELATION, says=says, pads=(pad,), field=field, detail=detail
        )

    (one,) = shared([found("left"), found("right", says="in other words")])
    assert one.sentence == "both pads' as it is"
    for other in ({"kind": FindingKind.SIGN}, {"field": "force"}, {"detail": "6"}):
        two = [found("left"), found("right", **other)]
        assert shared(two) == two


def test_a_force_of_noise_alone_is_dead_and_a_pad_that_feels_nothing_is_left_to_the_contact(sound):
    recording, mesh = sound
    rng = np.random.default_rng(2)
    dead = on_pads(lambda p: replace(p, force_N=rng.normal(0, 0.008, p.force_N.shape)))(recording)
    assert "force is dead" in findings(dead, mesh)[0].sentence
    silent = on_pads(lambda p: replace(p, displacement_mm=rng.normal(0, 0.004, p.force_N.shape)))(dead)
    assert findings(silent, mesh) == []


def test_a_gain_widens_the_error_by_what_it_may_do(sound):
    recording, mesh = sound
    (one,) = findings(force(1.2, "left")(recording), mesh)
    (two,) = findings(force(1.2)(recording), mesh)
    assert two.relative_sd == pytest.approx(0.7 * np.log(1.2), rel=0.05)
    assert one.relative_sd == pytest.approx(two.relative_sd / 2, rel=0.1)


@pytest.mark.parametrize("times", [0.93, 1.1])
def test_a_mesh_of_another_size_is_refused_with_both_widths(sound, times):
    recording, (vertices, faces) = sound
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    (found,) = findings(recording, (middle + times * (vertices - middle), faces))
    assert found.refused
    said = re.search(r"\(([0-9.]+) times\)", found.sentence)
    assert said is not None
    assert float(said.group(1)) == pytest.approx(times, abs=0.005)
    assert "another fruit" in found.sentence


def test_frames_are_dropped_where_time_steps_are_multiples_and_not_where_a_clock_jitters():
    steps = 0.03 * np.ones(60)
    assert dropped_steps(np.cumsum(steps)) == 0
    uneven = steps * (1 + 0.3 * np.random.default_rng(1).normal(size=60))
    assert dropped_steps(np.cumsum(np.abs(uneven))) <= 2
    paces = np.repeat([0.03, 0.3, 0.06], 20)
    assert dropped_steps(np.cumsum(paces)) == 0
    third = np.delete(np.cumsum(steps), np.arange(2, 60, 3))
    assert dropped_steps(third) == len(third) // 2 - 1


def test_a_recording_that_ends_pressed_is_remarked_and_nothing_is_put_in_doubt(sound):
    recording, mesh = sound
    peak = int(np.argmax(recording.pads[0].force_N[:, :, 2].sum(axis=1)))
    (found,) = findings(kept(slice(peak + 1))(recording), mesh)
    assert found.kind is FindingKind.ENDS_PRESSED
    assert found.remark
    assert found.relative_sd == 0.0
    assert not found.refused
    assert found.pads == ("left", "right")


def closing_at(mm_per_s):
    """The recording with its clock stretched so that its jaws close so fast at most."""

    def change(recording):
        fastest = np.abs(np.diff(recording.aperture_mm) / np.diff(recording.time_s)).max()
        return replace(recording, time_s=recording.time_s * fastest / mm_per_s)

    return change


@pytest.mark.parametrize("mm_per_min", [1.0, 10.0, 500.0])
def test_a_testing_machines_speeds_are_sound(sound, mm_per_min):
    recording, mesh = sound
    assert findings(closing_at(mm_per_min / 60)(recording), mesh) == []


@pytest.mark.parametrize(("mm_per_s", "unit"), [(1.5e-3, "milliseconds"), (500.0, "minutes or hours")])
def test_a_clock_in_another_unit_is_remarked_of_jaws_alone_and_puts_nothing_in_doubt(sound, mm_per_s, unit):
    recording, mesh = sound
    strange = closing_at(mm_per_s)(recording)
    (found,) = findings(strange, mesh)
    assert found.kind is FindingKind.TIME_UNIT
    assert f"time_s looks like {unit}" in found.sentence
    assert found.remark
    assert found.relative_sd == 0.0
    pressed = replace(strange, loading="press", aperture_mm=-strange.aperture_mm)
    assert FindingKind.TIME_UNIT not in {one.kind for one in findings(pressed, mesh)}


def said_of_noise(share):
    """What the checks of noise say of a pad whose displacement has this share of noise."""
    pressing = replace(pressing_of(slab_pad()), force_sd_N=0.0)
    deep = noise_shares(pressing)[0] / pressing.felt_sd_mm
    return noise_findings([replace(pressing, felt_sd_mm=share / deep)])


def test_noise_as_of_the_softest_gel_share_is_sound_and_a_little_more_is_said():
    assert said_of_noise(0.0545) == []
    (found,) = said_of_noise(0.066)
    assert found.kind is FindingKind.NOISE
    assert not found.refused
    assert found.relative_sd == pytest.approx(6.0 * 0.066)
    assert said_of_noise(0.11)[0].refused


def test_pads_exchanged_and_a_mesh_turned_are_named_where_the_sides_of_the_fruit_differ():
    """On prints by the numbers of a fruit whose sides differ: the left's skin leans, the right's does not."""

    def prints(left, right):
        return [
            Footprint(
                name=name, ahead_mm=0.0, ahead_sd_mm=0.1, middle_mm=30.0 * np.array(t), tilt=np.array(t)
            )
            for name, t in (("left", left), ("right", right))
        ]

    level, leaning = [0.004, -0.006], [0.03, 0.02]
    off, fits = prints(leaning, leaning), prints(level, level)
    found = better_otherwise(off, [(FindingKind.PADS_EXCHANGED, fits)], surface_sd_mm=0.0)
    assert found is not None
    assert found.kind is FindingKind.PADS_EXCHANGED
    assert "exchanged (left and right)" in found.sentence
    turned = better_otherwise(
        off, [(FindingKind.PADS_EXCHANGED, off), (FindingKind.MESH_TURNED, fits)], surface_sd_mm=0.0
    )
    assert turned is not None
    assert turned.kind is FindingKind.MESH_TURNED
    for others in (
        [],
        [(FindingKind.PADS_EXCHANGED, off)],
        [(FindingKind.PADS_EXCHANGED, prints(level, [np.nan] * 2))],
    ):
        assert better_otherwise(off, others, surface_sd_mm=0.0) is None
    assert better_otherwise(fits, [(FindingKind.PADS_EXCHANGED, fits)], surface_sd_mm=0.0) is None
    assert better_otherwise(off, [(FindingKind.PADS_EXCHANGED, fits)], surface_sd_mm=0.5) is None


@pytest.mark.parametrize("turn", QUARTERS[:4])
def test_a_mesh_that_lies_on_its_side_is_named(sound, turn):
    recording, (vertices, faces) = sound
    middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    (found,) = findings(recording, (middle + (vertices - middle) @ turn, faces))
    assert found.kind is FindingKind.MESH_TURNED
    assert "turned by a quarter" in found.sentence


def test_a_mesh_moved_along_the_pads_is_said(sound):
    recording, (vertices, faces) = sound
    aside = recording.pads[0].pose[0, :3, 0]
    found = findings(recording, (vertices + 3.0 * aside, faces))
    assert found
    assert "middle of the" in found[0].sentence
    assert not found[0].refused


def test_missing_sites_are_those_left_out_and_no_others():
    line = np.arange(12.0)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    assert len(missing_sites(grid)) == 0
    out = (np.abs(grid - [5, 6]) < 1.5).all(axis=1)
    sites = missing_sites(grid[~out])
    assert sorted(map(tuple, np.round(sites).tolist())) == sorted(map(tuple, grid[out].tolist()))
    hexagonal = grid @ np.array([[1.0, 0.0], [0.5, 0.75**0.5]])
    assert len(missing_sites(hexagonal)) == 0
    assert len(missing_sites(np.delete(hexagonal, 70, axis=0))) == 1


def test_a_hole_of_eight_by_eight_markers_is_found_whole():
    line = np.arange(20.0)
    grid = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    out = np.abs(grid - 9.5).max(axis=1) < 4.0
    assert out.sum() == 64
    assert sorted(map(tuple, np.round(missing_sites(grid[~out])).tolist())) == sorted(
        map(tuple, grid[out].tolist())
    )


def test_markers_in_no_grid_miss_none():
    scattered = np.random.default_rng(0).uniform(0, 20, (300, 2))
    assert len(missing_sites(scattered)) == 0


def test_a_factor_is_a_unit_only_near_it():
    assert unit_like(102.0, FORCE) == "grams"
    assert unit_like(2.0, FORCE) is None
    assert unit_like(-1.0, FORCE) is None


@cache
def slab_pad():
    """A slab under growing pressure, forces by the inverse of its displacement."""
    slab = GelSlab(thickness_mm=4.0, E_MPa=0.2, nu=0.48)
    line = 1.5 * (np.arange(9) - 4.0)
    rest = np.column_stack([np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2), np.zeros(81)])
    fine = np.arange(-5, 5.01, 0.5)
    nodes = np.stack(np.meshgrid(fine, fine), axis=-1).reshape(-1, 2)
    compliance = -tent_compliance(slab, rest[:, :2], nodes, pitch_mm=0.5)
    rng = np.random.default_rng(0)
    inverse = InvertedForce(
        gel_grid(slab, rest), np.tile(np.eye(3) / 0.004**2, (81, 1, 1)), INITIAL_HYPERPARAMETERS
    )
    moved, pushed = [], []
    for depth in (*np.zeros(4), *np.linspace(0.2, 1, 4), 0.6, 0.0, 0.0):
        within = 1 - (nodes**2).sum(axis=1) / (20.0 * depth + 1e-9)
        load = np.outer(0.015 * np.sqrt(depth * np.maximum(within, 0.0)), [0.2, 0.0, 1.0])
        seen = np.einsum("nimj,mj->ni", compliance, load) + rng.normal(0, 0.004, rest.shape)
        moved.append(seen)
        pushed.append(inverse.solve(seen).force_N)
    return GelPad(
        name="left",
        pose=np.tile(np.eye(4), (len(moved), 1, 1)),
        rest_mm=rest,
        displacement_mm=np.array(moved),
        force_N=np.array(pushed),
        gel_kn_MPa_per_mm=slab.oedometric_MPa / 4.0,
        gel_kt_MPa_per_mm=slab.shear_MPa / 4.0,
        thickness_mm=4.0,
        gel_E_MPa=0.2,
        gel_nu=0.48,
    )


def test_a_slabs_forces_follow_its_own_law_and_not_that_of_springs():
    pad = slab_pad()
    by_slab = relation_of(pressing_of(pad))
    by_springs = relation_of(pressing_of(replace(pad, gel_E_MPa=None)))
    assert by_slab.gain == pytest.approx(1.0, abs=0.03)
    assert by_slab.over_markers > 0.95
    assert by_springs.gain < 0.6


def test_a_slab_with_more_markers_than_its_law_is_computed_for_is_not_judged_by_that_of_springs(monkeypatch):
    side = int(np.ceil(np.sqrt(MOST_FOR_SLAB + 1)))
    line = 0.7 * np.arange(float(side))
    flat = np.stack(np.meshgrid(line, line), axis=-1).reshape(-1, 2)
    pad = slab_pad()
    force_N = np.ones((len(pad.pose), len(flat), 3))
    rest_mm = np.column_stack([flat, np.zeros(len(flat))])
    many = replace(pad, rest_mm=rest_mm, force_N=force_N, displacement_mm=force_N)
    assert displacement_of(many, force_N) is None
    assert displacement_of(replace(many, gel_E_MPa=None), force_N) is not None
    monkeypatch.setattr("tactile.checks.gel_law.MOST_FOR_SLAB", len(pad.rest_mm) - 1)
    assert relation_of(pressing_of(pad)) is None
    springs = replace(pad, gel_E_MPa=None)
    assert relation_findings([pressing_of(springs)], closing_mm=[1.0], E_range_MPa=None)[0].refused
    assert relation_findings([pressing_of(pad)], closing_mm=[1.0], E_range_MPa=None) == []
