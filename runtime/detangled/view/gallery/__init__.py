"""The paper's figures, made by this program on its own models: one module a figure, each with its ``FIGURE``.

They are how the project looks at its quality after a change, so a figure's caption says what was measured, and its note
where it does not show what the paper's figure shows.
"""
