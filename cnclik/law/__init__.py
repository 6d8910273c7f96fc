"""The law q̇ = f(q, t) that the loop follows."""
