"""Relations of the diesel at one point, put together as the loops over samples put them together."""

from lpvobs.engines.diesel import relations as relation


def rho_1(c, p_im, omega_t, p_amb, T_amb):
    """Return rho_1 [kg/rad] of Eq. (3), so that W_c = rho_1 omega_t."""
    return relation.rho_1_of(c, relation.head(c, p_im, p_amb), omega_t, p_amb, T_amb)


def turbine(c, p_em, u_vgt, T_em, p_amb):
    """Return rho_4 [kg/(s Pa)] of Eq. (3), so that W_t = rho_4 p_em, and the expansion ratio Pi_t = p_es / p_em."""
    scale = relation.turbine_scale(c, u_vgt, T_em)
    p_es, flow, Pi_t = p_amb, 0.0, 0.9999
    for _ in range(relation.TURBINE_PASSES):
        flow, Pi_t, p_es = relation.turbine_pass(c, scale, p_es, p_em, p_amb)
    return flow, Pi_t
