
const @{name}_real @{name}_start_q[@{n}] = {
@{start_q}
};

const @{name}_real @{name}_start_z[@{m}] = {
@{start_z}
};

int @{name}_loops_start(@{name}_loops *loops, const @{name}_real q[@{n}])
{
    int failed = 0;
    int step;
    int i;
    for (i = 0; i < @{m}; i++) {
        loops->z[i] = @{name}_start_z[i];
    }
    for (step = 1; (step <= @{segments}) && (failed == 0); step++) {
        const @{real} share = (@{real})step / (@{real})@{segments};
        @{name}_real there[@{n}];
        for (i = 0; i < @{n}; i++) {
            there[i] = @{name}_start_q[i] + (share * (q[i] - @{name}_start_q[i]));
        }
        failed = @{name}_loops_update(loops, there);
    }
    return failed;
}

int @{name}_loops_update(@{name}_loops *loops, const @{name}_real q[@{n}])
{
    @{name}_real z[@{m}];
    const int failed = @{name}_close(q, loops->z, z, &loops->bound);
    int i;
    for (i = 0; i < @{m}; i++) {
        loops->z[i] = z[i];
    }
    return failed;
}
