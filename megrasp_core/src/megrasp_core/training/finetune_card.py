"""The model card of a fine-tuned model."""

from __future__ import annotations

from megrasp_core.network import ModelInfo


def finetune_card(info: ModelInfo, command: str) -> str:
    """Markdown from what `config.json` says.

    Args:
        info: of the fine-tuned model.
        command: that made it.
    """
    facts, parent = info.finetuned, info.started_from.get("model_id", "?")
    grasps = facts["grasps"]
    lines = [
        f"# {info.model_id}",
        "",
        f"{parent}, fine-tuned for {facts['gripper']} on {len(grasps)} given "
        f"grasp{'s' * (len(grasps) != 1)} (`megrasp finetune`). Only the gripper encoder learnt; "
        "scene encoder, decoder and heads are those of the parent.",
        "",
        "| | |",
        "| --- | --- |",
        f"| parent | {parent}, weights {info.started_from.get('sha256', '?')[:16]} |",
        f"| gripper | {facts['gripper']}, description {facts['gripper_hash']} |",
        f"| grasps | {', '.join(grasp['cloud'] for grasp in grasps)}; SHA-256 in `config.json` |",
        f"| command | `{command}` |",
        f"| steps | {facts['steps']}, seed {facts['settings']['seed']} |",
        f"| other grippers | their codes moved by at most {facts['others_moved']:.3f} standard "
        "deviations |",
        "| score | the calibration is that of the parent, and the confidence of the gripper was "
        "held to the parent's: successes alone say nothing of what fails |",
        "",
        "## Grasps left out",
        "",
    ]
    if "left_out" not in facts:
        lines.append(
            "Too few grasps were given to leave any out: nothing shows that the model is better."
        )
    else:
        found = facts["left_out"]
        lines += [
            "Diffusion loss of each grasp with a model that the others taught, by noise level:",
            "",
            "| | " + " | ".join(found["before"]) + " |",
            "| --- |" + " --- |" * len(found["before"]),
            *(
                f"| {name} | " + " | ".join(f"{v:.3f}" for v in found[name].values()) + " |"
                for name in ("before", "after")
            ),
            "",
            f"Gain {found['gain']:.4f}, standard error {found['gain_error']:.4f}. No rate of "
            "success was measured: `megrasp eval --model` does.",
        ]
    return "\n".join(lines) + "\n"
