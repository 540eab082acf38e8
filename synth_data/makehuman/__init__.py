"""MakeHuman heads (CC0) with ARKit face units: identities, personal rigs and expressions."""
