"""What a batch's settings name must be there before work begins."""

import pytest

from pipeline.batch.opening import survey


def said(folder, text):
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
    (sentence_found,) = said(tmp_path, f"[recon]\nproviders = {providers}\n")
    assert sentence in sentence_found


def test_providers_that_another_machine_has_may_stand_before_one_that_this_has(tmp_path):
    text = '[recon]\nproviders = ["CUDAExecutionProvider", "CPUExecutionProvider"]\n'
    assert said(tmp_path, text) == []
