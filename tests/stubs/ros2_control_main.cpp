// The manager of ros2_control: configures, activates, updates at 1 kHz, writes the rows, deactivates.
#include <cstdio>
#define SWING_STDIO
#include "ros2_control.cpp"
int main()
{
    haptid_campaign::Campaign c;
    const rclcpp_lifecycle::State now;
    c.on_init();
    if (c.on_configure(now) == controller_interface::CallbackReturn::SUCCESS) { return 2; }  // no joints
    c.node_->of["joints"].s = {"a", "b", "c"};
    c.node_->of["kp"].x = 1.0;
    c.node_->of["kd"].x = 0.05;
    c.node_->of["speed"].x = 1.0;
    if (c.on_configure(now) != controller_interface::CallbackReturn::SUCCESS) { return 3; }
    if (c.state_interface_configuration().names.at(2) != "c/position") { return 4; }
    c.state_interfaces_.resize(3);
    c.command_interfaces_.resize(3);
    if (c.on_activate(now) != controller_interface::CallbackReturn::SUCCESS) { return 5; }
    static swing_row rows[256];
    double tau[3];
    for (int k = 0; k < 20000 && !c.done(); ++k) {
        for (std::size_t j = 0; j < 3; ++j) { c.state_interfaces_[j].v = plant_q[j]; }
        c.update({}, {1e-3});
        for (std::size_t j = 0; j < 3; ++j) { tau[j] = c.command_interfaces_[j].v; }
        plant_torque(tau);
        swing_print(stdout, rows, c.rows(rows, 256), k == 0);
    }
    c.on_deactivate(now);
    return c.done() && c.command_interfaces_[0].v == 0.0 ? 0 : 1;
}
