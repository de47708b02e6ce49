
@{name}_real @{name}_apparent_mass(const @{name}_real mobility[9], const @{name}_real direction[3])
{
    @{real} length = @{zero};
    @{real} moved = @{zero};
    int i;
    int j;
    for (i = 0; i < 3; i++) {
        length += direction[i] * direction[i];
        for (j = 0; j < 3; j++) {
            moved += direction[i] * mobility[(3 * i) + j] * direction[j];
        }
    }
    return (moved > @{zero}) ? (length / moved) : (@{real})HUGE_VAL;
}
