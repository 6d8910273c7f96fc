"""What the loop is asked to do: q̇ = f(q, t)."""
