"""The closest joints with exactly these bone lengths, eq. (1), one constraint per bone.

    minimise    f(x) = Σ w_i ‖x_i − m_i‖²      over joints i
    subject to  ‖x_i − x_p(i)‖ = l_i           for the bone from each joint i to its parent p(i)

With m_i the weighted mean of p_i and R q_i + t, and w_i = w_i^A + w_i^B, f is eq. (1)'s objective up to a
constant. Eq. (1) adds all bones into one scalar constraint, which does not enforce them (``docs/method.md``).
"""

MAX_ITERATIONS = 50
"""Of any solver, sec. 2."""
