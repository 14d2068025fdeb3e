# %% [markdown]
# The paper's pass: what eq. (1) as printed promises, and what is left when the arm's inertia is in it.

# %%
from kr270_milling import compensate, read_cell, simulate

cell = read_cell("paper.yaml")
print(simulate(cell))

# %% as printed: the paper's own method leaves a few micrometres
printed = compensate(cell, "linear")
print(printed.compensated)

# %% the same reference on an arm whose motor side is moved by it
real = read_cell("paper.yaml", "dynamics.reference_inertia=true")
print(simulate(real, printed.compensated.reference))

# %% knots from the response of the arm
inverse = compensate(real, "inverse")
print(inverse.compensated)

# %% deviation and force over time: figure.show() in a notebook
figure = inverse.compensated.plot()
