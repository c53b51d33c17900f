"""The Q-network and the Double-DQN loss once more, in PyTorch, written down from the paper."""

import torch
from torch.nn import functional


def q_values(weights: dict[str, torch.Tensor], whole: torch.Tensor, near: torch.Tensor) -> torch.Tensor:
    """All outputs, [batch, 1 or 2, 961]: Q-values, and predicted rewards if there is a head for them."""

    def layer(name: str, inputs: torch.Tensor, stride: int = 1) -> torch.Tensor:
        weight, bias = weights[f"{name}.weight"], weights[f"{name}.bias"]
        return functional.conv2d(inputs, weight, bias, stride, weight.shape[-1] // 2)

    def transposed(name: str, inputs: torch.Tensor, stride: int = 1) -> torch.Tensor:
        return functional.conv_transpose2d(inputs, weights[f"{name}.weight"], weights[f"{name}.bias"], stride, 1)

    for name in ("map.0", "map.1", "map.2"):
        whole = layer(name, whole, 2).relu()
    whole = transposed("map.3", whole, 2).relu()
    for name in ("window.0", "window.1"):
        near = layer(name, near).relu()
    hidden = transposed("head.0", torch.cat([whole, near], 1)).relu()
    outputs = transposed("head.1", hidden).flatten(2)
    if "value.weight" not in weights:
        return outputs
    value = functional.linear(hidden.mean((2, 3)), weights["value.weight"], weights["value.bias"])
    advantages = outputs[:, :1]
    return torch.cat([advantages - advantages.mean(2, keepdim=True) + value[:, None], outputs[:, 1:]], 1)


def loss(
    policy: dict[str, torch.Tensor], target: dict[str, torch.Tensor], batch: dict[str, torch.Tensor], preset: str
) -> tuple[torch.Tensor, torch.Tensor]:
    """What is minimised, and its part of Q-values."""
    with torch.no_grad():
        online = q_values(policy, batch["next_map"], batch["next_window"])[:, 0]
        if preset != "paper":
            online = online.masked_fill(batch["next_permissible"] == 0, -torch.inf)
        best = online.argmax(1)
        value = q_values(target, batch["next_map"], batch["next_window"])[torch.arange(len(best)), 0, best]
        y = batch["reward"].index_add(0, batch["next_of"], batch["discount"] * value)
    outputs = q_values(policy, batch["map"], batch["window"])
    q = outputs[:, 0]
    taken = q[torch.arange(len(y)), batch["action"]]
    if preset == "paper":
        q_loss = ((y - taken) ** 2).mean()
        return q_loss + (batch["reward"] ** 2).mean(), q_loss
    errors = functional.huber_loss(taken, y, reduction="none")
    q_loss = (errors * batch["weights"]).mean() if preset == "other" else errors.mean()
    terminal = batch["all_terminal"]
    dense = (functional.huber_loss(q, torch.zeros_like(q), reduction="none") * terminal).sum() / terminal.sum().clamp(1)
    rewards = ((outputs[:, 1] - batch["all_rewards"]) ** 2).mean()
    return q_loss + dense + rewards, q_loss
