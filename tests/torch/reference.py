"""The Q-networks and the losses once more, in PyTorch: the paper's, and what preset best learns instead."""

import torch
from torch.nn import functional

Weights = dict[str, torch.Tensor]


def outputs_of(weights: Weights, whole: torch.Tensor, near: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """What the last layer gets and makes of it, [batch, channels, 31, 31] each."""

    def layer(name: str, inputs: torch.Tensor, stride: int = 1) -> torch.Tensor:
        weight, bias = weights[f"{name}.weight"], weights[f"{name}.bias"]
        return functional.conv2d(inputs, weight, bias, stride, 0 if weight.shape[-1] == 7 else weight.shape[-1] // 2)

    def transposed(name: str, inputs: torch.Tensor, stride: int = 1) -> torch.Tensor:
        return functional.conv_transpose2d(inputs, weights[f"{name}.weight"], weights[f"{name}.bias"], stride, 1)

    for name in ("map.0", "map.1", "map.2"):
        whole = layer(name, whole, 2).relu()
    if "up.0.weight" not in weights:
        whole = transposed("map.3", whole, 2).relu()
        for name in ("window.0", "window.1"):
            near = layer(name, near).relu()
        hidden = transposed("head.0", torch.cat([whole, near], 1)).relu()
        return hidden, transposed("head.1", hidden)
    whole = layer("map.3", whole).relu()
    full = layer("window.0", near).relu()
    half = layer("window.2", layer("window.1", full, 2).relu()).relu()
    quarter = layer("window.4", (layer("window.3", half, 2) + whole).relu()).relu()
    half = layer("up.1", torch.cat([transposed("up.0", quarter, 2).relu(), half], 1)).relu()
    up = transposed("up.2", half, 2).relu()
    # The whole pass is cut in the end only; the trainer cuts as soon as it can.
    hidden = layer("head.0", torch.cat([up, full], 1)[..., 15:-15, 15:-15]).relu()
    return hidden, layer("head.1", hidden)


def q_values(weights: Weights, whole: torch.Tensor, near: torch.Tensor, preset: str) -> dict[str, torch.Tensor]:
    """Q-values, [batch, 961], and what else there is a head for."""
    hidden, outputs = outputs_of(weights, whole, near)
    first, *others = outputs.flatten(2).unbind(1)
    if "value.weight" in weights:
        level = functional.linear(hidden.mean((2, 3)), weights["value.weight"], weights["value.bias"])
        if preset == "factored":
            (holes,) = others
            q = (1 - holes.sigmoid()) * (-0.25 + 0.99 * (first + level))
            return {"q": q, "level": level[:, 0], "advantages": first, "holes": holes}
        first = first - first.mean(1, keepdim=True) + level
    names = ("holes",) if preset == "best" else ("rewards", "holes")
    return {"q": first} | dict(zip(names, others, strict=False))


def loss(policy: Weights, target: Weights, batch: dict[str, torch.Tensor], preset: str) -> dict[str, torch.Tensor]:
    """What is minimised, and its parts."""
    with torch.no_grad():
        online = q_values(policy, batch["next_map"], batch["next_window"], preset)["q"]
        if preset != "paper":
            online = online.masked_fill(batch["next_allowed"] == 0, -torch.inf)
        best = online.argmax(1)
        value = q_values(target, batch["next_map"], batch["next_window"], preset)["q"]
        value = value[torch.arange(len(best)), best]
        if preset != "factored":
            y = batch["reward"].index_add(0, batch["next_of"], batch["discount"] * value)
    outputs = q_values(policy, batch["map"], batch["window"], preset)
    q, rows = outputs["q"], torch.arange(len(batch["reward"]))
    if preset == "paper":
        q_loss = ((y - q[rows, batch["action"]]) ** 2).mean()
        return {"loss": q_loss + (batch["reward"] ** 2).mean(), "q_loss": q_loss}
    terminal, allowed = batch["all_terminal"], batch["all_allowed"]
    errors = functional.binary_cross_entropy(outputs["holes"].sigmoid(), terminal, reduction="none")
    hole_loss = torch.stack([row[of > 0].mean() for row, of in zip(errors, allowed, strict=True)]).mean()
    if preset == "factored":
        levels, moves = [], []
        for state in batch["next_of"].unique():
            of = batch["next_of"] == state
            advantages, wanted = outputs["advantages"][state, batch["next_action"][of]], value[of]
            level = outputs["level"][state] + advantages.detach().mean()
            levels.append(functional.huber_loss(level, wanted.mean()))
            compared = (advantages - advantages.mean(), wanted - wanted.mean())
            moves.append(functional.huber_loss(*compared, reduction="none"))
        q_loss = torch.stack(levels).mean() + torch.cat(moves).mean()
        return {"loss": q_loss + hole_loss, "q_loss": q_loss, "hole_loss": hole_loss}
    errors = functional.huber_loss(q[rows, batch["action"]], y, reduction="none")
    if preset == "best":
        return {"loss": errors.mean() + hole_loss, "q_loss": errors.mean(), "hole_loss": hole_loss}
    q_loss = (errors * batch["weights"]).mean()
    dense = functional.huber_loss(q[terminal > 0], torch.zeros_like(q[terminal > 0]))
    rewards = ((outputs["rewards"] - batch["all_rewards"]) ** 2).mean()
    return {"loss": q_loss + dense + rewards + hole_loss, "q_loss": q_loss, "hole_loss": hole_loss}
