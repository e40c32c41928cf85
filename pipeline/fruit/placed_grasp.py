"""One recording on one fruit: the interface between tactile's contact and fem's flesh."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from fem.estimation.modulus import ModulusEstimate
from fem.fem_failure import FemFailure
from fem.grasp_history import SMALLEST_SD_MM, SMALLEST_SHARE_OF_FORCE, GraspHistory, PadHistory
from fem.mismatch.mismatch_case import GraspCase, PadMotion
from pipeline.batch.settings import SensorSettings
from pipeline.fruit.model_curve import frame_records, model_curves, residual_at_full_load
from pipeline.fruit.sensor_scale import known_gels
from recon.checks.surface_error import sd_on_patch_mm
from reports.grasp_record import CurveRecord, GraspRecord
from reports.skin_layer import PatchResidual
from tactile.consistency.finding import Finding, FindingKind
from tactile.consistency.of_recording import jaw_share_findings, recording_findings
from tactile.contact import Contact, find_contact
from tactile.correction import Fault, corrected
from tactile.plain_jaw import has_plain_jaw, with_plain_jaw
from tactile.readers.recording import GelPad, Recording, read_recording, recording_digest
from tactile.registration import PadRegistration, register
from tactile.rig.rig_curve import RigCurve
from tactile.robot.pad_poses import moved_wrench
from tactile.tactile_failure import TactileFailure, TactileProblem


@dataclass(frozen=True)
class PlacedGrasp:
    """A recording whose pads are located on the fruit's surface; `path` is the file that it was read from.

    `surface_sd_mm`: for each pad, the root mean square of the mesh's error over the skin within its contact
    patch. It needs the mesh's error at each vertex. `findings`: contradictions in the recording that leave it
    usable. `digest`: of its fields as they are in the file (tactile.readers.recording). `plain_jaw`: whether
    one pad represents a jaw without a gel (tactile.plain_jaw); `plane_strain_MPa`: of the flesh, if the width
    of that jaw's contact follows from it.
    """

    name: str
    path: Path
    recording: Recording
    contact: Contact
    pads: tuple[PadRegistration, ...]
    surface_sd_mm: Mapping[str, float] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    digest: str = ""
    plain_jaw: bool = False
    plane_strain_MPa: float | None = None

    @property
    def touched_mm(self) -> dict[str, Float[np.ndarray, "_p 3"]]:
        """Where on the surface each pad's markers touch."""
        return {
            pad.name: pad.surface_mm[contact.onset >= 0]
            for pad, contact in zip(self.pads, self.contact.pads, strict=True)
        }


@dataclass(frozen=True, kw_only=True)
class Checked:
    """Inputs of a recording's checks: range of moduli of the category, the mesh's error, and the machine
    compliance if the recording was corrected for it; `sensor`: what batch.toml states about the sensor.
    `explains`: for the mismatch finder, which accepts recordings with a fault that it models as an effect
    (Finding.has_effect).
    """

    E_range_MPa: tuple[float, float] | None = None
    surface_sd_mm: float = 0.0
    rig: RigCurve | None = None
    sensor: SensorSettings | None = None
    explains: bool = False


def place_grasp(
    path: Path,
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    *,
    name: str | None = None,
    faults: Sequence[Fault] = (),
    sd_mm: Float[np.ndarray, " v"] | None = None,
    checked: Checked | None = None,
    admit: Callable[[Recording], Sequence[Finding]] | None = None,
    plane_strain_MPa: float | None = None,
    mat_from_fruit: Float[np.ndarray, "4 4"] | None = None,
) -> PlacedGrasp:
    """The recording at `path` without the jaws' known faults, its contact, and where its pads touch.

    `name`: its name for users; None: the file's. `sd_mm`: the mesh's error at each vertex, if it is known;
    the skin within a patch is sampled where the pad's markers touch it, on an even grid. `checked`: inputs of
    the checks of its fields with each other and the mesh; None: no checks. `admit` first checks that the
    recording is this fruit's (pipeline.fruit.recording_owner), and raises if it is not. `plane_strain_MPa`:
    of the flesh, for a plain jaw's contact. `mat_from_fruit`: the fruit's pose on the mat, for poses in the
    mat's frame. Raises TactileFailure; implausible-recording if the checks refuse it.
    """
    name = name or path.stem
    source = path.name if path.stem == name else name
    recorded = read_recording(path)
    findings = () if admit is None else tuple(admit(recorded))
    recording = corrected(_in_fruit_frame(recorded, mat_from_fruit, source), faults, source=source)
    _refuse_no_pose(recording, source)
    if checked is not None:
        findings += findings_of(recording, vertices, faces, source, checked, corrected_for=len(faults))
    recording = with_plain_jaw(recording, vertices, source=source, plane_strain_MPa=plane_strain_MPa)
    contact = find_contact(recording, source=source)
    pads = register(contact, vertices, faces, source=source)
    placed = PlacedGrasp(
        name=name,
        path=path,
        recording=recording,
        contact=contact,
        pads=pads,
        findings=findings,
        digest=recording_digest(recorded),
        plain_jaw=has_plain_jaw(recorded),
        plane_strain_MPa=plane_strain_MPa,
    )
    if sd_mm is None:
        return placed
    known = {
        pad: sd_on_patch_mm(points, vertices, faces, sd_mm)
        for pad, points in placed.touched_mm.items()
        if len(points)
    }
    return replace(placed, surface_sd_mm=known)


def findings_of(
    recording: Recording,
    vertices: Float[np.ndarray, "v 3"] | None,
    faces: Int[np.ndarray, "f 3"] | None,
    source: str,
    checked: Checked,
    *,
    corrected_for: int,
) -> tuple[Finding, ...]:
    """The checks' findings; without a mesh (None), on the recording alone. Raises TactileFailure
    (implausible-recording) if they make the recording unusable.

    `corrected_for`: number of confirmed faults of the gripper that were removed from it before.
    """
    findings = recording_findings(
        recording,
        vertices,
        faces,
        E_range_MPa=checked.E_range_MPa,
        surface_sd_mm=checked.surface_sd_mm,
        gels=known_gels(recording.sensor, checked.sensor),
    )
    findings += read_otherwise(recording)
    if checked.rig is not None:
        findings += jaw_share_findings(recording, checked.rig)
    if checked.explains:
        findings = [
            replace(finding, refused=finding.refused and not finding.has_effect) for finding in findings
        ]
    if said := refusal(findings, corrected_for=corrected_for):
        raise TactileFailure(TactileProblem.IMPLAUSIBLE_RECORDING, f"{source}: {said}.")
    return tuple(findings)


def read_otherwise(recording: Recording) -> list[Finding]:
    """Remarks where the recording's reader interpreted the file differently."""
    kind = FindingKind.READ_OTHERWISE
    return [Finding(kind=kind, says=note, remark=True) for note in recording.notes]


def refusal(findings: Sequence[Finding], *, corrected_for: int) -> str:
    """Why a recording with these findings is unusable, without a full stop; empty if it is usable.

    `corrected_for`: number of confirmed faults of the gripper removed from it before: they may be the
    mistake.
    """
    said = "; ".join(finding.sentence for finding in findings if finding.refused)
    if said and corrected_for:
        said += "; [[mismatch]] in batch.toml corrected it before, so check those numbers too"
    return said


def _in_fruit_frame(
    recording: Recording, mat_from_fruit: Float[np.ndarray, "4 4"] | None, source: str
) -> Recording:
    """The recording, poses and wrench, in the fruit frame; refuses the mat's frame without a mat."""
    if recording.pose_frame == "fruit":
        return recording
    if mat_from_fruit is None:
        raise TactileFailure(
            TactileProblem.UNREADABLE_RECORDING,
            f"{source}: attribute pose_frame: found poses in the frame of the mat, expected photos of the "
            "fruit on that mat. Put its mat.json beside batch.toml.",
        )
    fruit_from_mat = np.linalg.inv(mat_from_fruit)
    pads = tuple(replace(pad, pose=fruit_from_mat @ pad.pose) for pad in recording.pads)
    wrench_N = recording.wrench_N
    if wrench_N is not None:
        wrench_N = moved_wrench(fruit_from_mat[None], wrench_N)
    return replace(recording, pads=pads, pose_frame="fruit", wrench_N=wrench_N)


def _refuse_no_pose(recording: Recording, source: str) -> None:
    """Refuses a pad at the fruit's foot, facing up, in every frame: nobody recorded where it was."""
    for pad in recording.pads:
        if isinstance(pad, GelPad) and (pad.pose == np.eye(4)).all():
            raise TactileFailure(
                TactileProblem.UNREADABLE_RECORDING,
                f"{source}: pads/{pad.name}/pose: found no pose (the identity in every frame), "
                "expected the pad's pose on the fruit in each frame; write the gripper's poses into "
                "the recording.",
            )


def touched_by_pad(grasps: Sequence[PlacedGrasp]) -> dict[str, Float[np.ndarray, "_p 3"]]:
    """Where each pad's markers touch, all grasps together."""
    names = {pad: None for grasp in grasps for pad in grasp.touched_mm}
    return {pad: np.vstack([g.touched_mm[pad] for g in grasps if pad in g.touched_mm]) for pad in names}


def patch_residuals(
    grasps: Sequence[PlacedGrasp], estimates: Sequence[ModulusEstimate | FemFailure]
) -> list[PatchResidual]:
    """The residuals under each pad at the greatest force, of all grasps with a modulus."""
    patches = []
    for grasp, estimate in zip(grasps, estimates, strict=True):
        if not isinstance(estimate, FemFailure):
            residuals = residual_at_full_load(estimate, history(grasp), *_axes_and_forces(grasp))
            patches += [
                PatchResidual(name=f"{grasp.name}, {pad}", places_mm=places, residual_um=values)
                for pad, (places, values) in residuals.items()
            ]
    return patches


def _axes_and_forces(grasp: PlacedGrasp) -> tuple[Float[np.ndarray, "p t 3"], Float[np.ndarray, "p t"]]:
    """For each pad over time: its axis into the fruit, and its normal force (N)."""
    pads = grasp.contact.pads
    return np.array([pad.pose[:, :3, 2] for pad in pads]), np.array([pad.total_normal_N for pad in pads])


def history(grasp: PlacedGrasp) -> GraspHistory:
    """Input of the modulus: the markers in and around each patch, over time, fruit frame.

    Markers around the patch that lie beside the fruit, and never touch, are left out.
    """
    pads = []
    for pad, contact in zip(grasp.pads, grasp.contact.pads, strict=True):
        used = contact.patch & (pad.on_skin | (contact.onset >= 0))
        least_N = SMALLEST_SHARE_OF_FORCE * float(np.abs(contact.force_N).max())
        pads.append(
            PadHistory(
                name=contact.name,
                rest_mm=contact.rest_mm[used],
                surface_mm=pad.surface_mm[used],
                position_mm=contact.position_mm[:, used],
                gel_displacement_mm=contact.gel_displacement_mm[:, used],
                force_N=contact.force_N[:, used],
                episode=contact.episode[:, used],
                displacement_sd_mm=max(contact.displacement_noise.sd, SMALLEST_SD_MM),
                force_sd_N=max(contact.force_noise.sd, least_N),
                lag1=contact.displacement_noise.lag1,
                surface_sd_mm=grasp.surface_sd_mm.get(contact.name),
            )
        )
    return GraspHistory(time_s=grasp.contact.time_s, phase=tuple(grasp.contact.phase), pads=tuple(pads))


def grasp_case(grasp: PlacedGrasp) -> GraspCase:
    """The mismatch finder's input of one recording: the history, and how the machine drove its pads."""
    gels = {pad.name: pad for pad in grasp.recording.pads if isinstance(pad, GelPad)}
    return GraspCase(
        name=grasp.name,
        history=history(grasp),
        pads=tuple(
            PadMotion(
                name=contact.name,
                pose=contact.pose,
                normal_N=gels[contact.name].force_N[:, :, 2].sum(axis=1),
                markers=len(contact.rest_mm),
                gel_N_per_mm=gels[contact.name].marker_kn_N_per_mm,
            )
            for contact in grasp.contact.pads
        ),
        support=grasp.recording.support,
    )


def grasp_record(grasp: PlacedGrasp, estimate: ModulusEstimate | FemFailure) -> GraspRecord:
    """The record of one recording and its modulus, or why it has none."""
    if isinstance(estimate, FemFailure):
        return GraspRecord(grasp=grasp.name, failure=estimate.detail)
    curves, travel_mm = force_curves(grasp)
    axes, normal_N = _axes_and_forces(grasp)
    models = model_curves(estimate, history(grasp), axes, travel_mm, normal_N)
    curves = [curve.model_copy(update={"model": model}) for curve, model in zip(curves, models, strict=True)]
    frames = frame_records(estimate, travel_mm)
    energy = estimate.energy
    return GraspRecord(
        grasp=grasp.name,
        digest=grasp.digest,
        E_MPa=estimate.E_MPa,
        E_sd_MPa=estimate.E_sd_MPa,
        parts_sd_MPa=estimate.parts_sd_MPa,
        discretisation=estimate.discretisation,
        E_energy_MPa=energy.E_MPa if energy else None,
        E_energy_sd_MPa=energy.sd_MPa if energy else None,
        E_least_squares_MPa=estimate.E_MPa,
        E_least_squares_sd_MPa=estimate.E_sd_MPa,
        residual_um=1e3 * estimate.residual_rms_mm,
        noise_um=1e3 * max(pad.displacement_noise.sd for pad in grasp.contact.pads),
        registration_mm=max(pad.residual_mm for pad in grasp.pads),
        frames_used=int(estimate.loaded.sum()),
        markers_used=int(sum((pad.onset >= 0).sum() for pad in grasp.contact.pads)),
        peak_force_N=max(max(c.force_N) for c in curves),
        travel_mm=max(max(c.travel_mm) for c in curves),
        contact_mm={pad: np.round(points, 3).tolist() for pad, points in grasp.touched_mm.items()},
        curves=curves,
        frames=frames,
    )


def force_curves(grasp: PlacedGrasp) -> tuple[list[CurveRecord], Float[np.ndarray, " t"]]:
    """Normal force of each pad over travel of jaws or indenter since first touch, loaded frames; and that
    travel in every frame.
    """
    closing = -1.0 if grasp.recording.loading == "grasp" else 1.0
    path = closing * grasp.recording.aperture_mm
    touched = np.any([(pad.episode >= 0).any(axis=1) for pad in grasp.contact.pads], axis=0)
    first = int(np.argmax(touched))
    travel = path - path[first]
    curves = [
        CurveRecord(
            pad=pad.name,
            travel_mm=np.round(travel[touched], 4).tolist(),
            force_N=np.round(pad.total_normal_N[touched], 4).tolist(),
        )
        for pad in grasp.contact.pads
    ]
    return curves, travel
