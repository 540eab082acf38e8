"""Quasi-static simulation of tissue: energies, projections and the solver (AnaConDaR sections 3.3, 3.4, Appendix A)."""
