
/*
 * Apparent mass (effective mass) at the handle along a direction, kg, from the matrix of
 * @{name}_handle_mobility.
 * Infinite along a direction in which the handle cannot move.
 */
@{name}_real @{name}_apparent_mass(const @{name}_real mobility[9], const @{name}_real direction[3]);
