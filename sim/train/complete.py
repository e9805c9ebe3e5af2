"""The completion branch of core/net/README.md 2.14."""

from __future__ import annotations

import torch
from torch import Tensor, nn
from torch.nn import functional as F

INPUTS, OUTPUTS = 15, 3
WIDTH = (32, 48, 64, 96, 128, 128)
STAY = (0, 1, 1, 2, 1, 2)


class Conv(nn.Conv2d):
    """With its norm, where it has one; that has the bias then."""

    def __init__(self, a: int, b: int, size: int = 3, stride: int = 1, norm: bool = False):
        super().__init__(a, b, size, stride, size // 2, bias=not norm)
        self.norm = nn.BatchNorm2d(b, momentum=0.02) if norm else None

    def forward(self, x: Tensor) -> Tensor:
        x = super().forward(x)
        return self.norm(x) if self.norm else x

    def folded(self) -> tuple[Tensor, Tensor]:
        """Weight and bias that do without the norm."""
        n = self.norm
        if not n:
            return self.weight, self.bias
        k = n.weight / torch.sqrt(n.running_var + n.eps)
        return self.weight * k[:, None, None, None], n.bias - n.running_mean * k


class Complete(nn.Module):
    """(B, 15, h, w) to (B, 3, h, w). Without norms, its state dict is that of the checkpoint
    without the prefix "encoder.complete."."""

    def __init__(self, norm: bool = False):
        super().__init__()
        ends = zip((INPUTS, *WIDTH), WIDTH)
        self.down = nn.ModuleList(
            Conv(a, b, 3, 2 if l else 1, norm) for l, (a, b) in enumerate(ends)
        )
        self.stay = nn.ModuleList(
            nn.ModuleList(Conv(c, c, norm=norm) for _ in range(n)) for c, n in zip(WIDTH, STAY)
        )
        self.up = nn.ModuleList(Conv(b, a, 1) for a, b in zip(WIDTH, WIDTH[1:]))
        self.join = nn.ModuleList(Conv(c, c, norm=norm) for c in WIDTH[:-1])
        self.out = Conv(WIDTH[0], OUTPUTS)
        nn.init.normal_(self.out.weight, std=0.01)
        nn.init.zeros_(self.out.bias)

    def forward(self, x: Tensor) -> Tensor:
        levels = []
        for down, stay in zip(self.down, self.stay):
            x = down(x).relu()
            for conv in stay:
                x = x + conv(x).relu()
            levels.append(x)
        for l in reversed(range(len(self.up))):
            x = F.interpolate(self.up[l](x), levels[l].shape[-2:], mode="bilinear")
            x = self.join[l](x + levels[l]).relu()
        return self.out(x)

    def folded(self) -> dict[str, Tensor]:
        """The state dict of the same network without norms."""
        out = {}
        for name, m in self.named_modules():
            if isinstance(m, Conv):
                out[f"{name}.weight"], out[f"{name}.bias"] = (t.detach() for t in m.folded())
        return out
