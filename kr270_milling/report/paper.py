"""What [Klimchik2012] prints of its own result, to be set beside ours."""

__all__ = ["PAPER", "TABLE_2"]

PAPER = (
    "Klimchik, Bondarenko, Pashkevich, Briot, Furet: Compliance error compensation in robotic-based milling (2012), "
    "Table 2"
)

#: name of a pass -> static deviation [m], max deviation [m], low frequency [Hz]
TABLE_2 = {"original": (58.1e-6, 63.2e-6, 6.70), "linear": (0.14e-6, 4.70e-6, 6.70)}
