
/*
 * Mass that the hand feels along a direction, kg: of the matrix that @{name}_handle_mobility gives.
 * Infinite along a direction in which the handle cannot move.
 */
@{name}_real @{name}_apparent_mass(const @{name}_real mobility[9], const @{name}_real direction[3]);
