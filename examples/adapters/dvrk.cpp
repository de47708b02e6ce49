// Plays a campaign of `haptid excite --player swing.c` on an arm of the dVRK by its CRTK topics, and records it.
//
//   ros2 run ... --ros-args -r __ns:=/PSM1 > swing-1.csv
//
// measured_js brings positions and the torques measured by the currents, which are what is recorded; servo_jf takes
// torques. Enable and home the arm first. The gains are yours: begin with small ones.
#include <cstdio>
#include <memory>
#include <rclcpp/rclcpp.hpp>
#include <sensor_msgs/msg/joint_state.hpp>
#define SWING_STDIO
#include "swing.c"

using sensor_msgs::msg::JointState;

class Campaign : public rclcpp::Node {
public:
    Campaign() : Node("haptid_campaign")
    {
        speed_ = declare_parameter<double>("speed", 0.2);
        kp_ = declare_parameter<double>("kp", 5.0);
        kd_ = declare_parameter<double>("kd", 0.2);
        torques_ = create_publisher<JointState>("servo_jf", 1);
        states_ = create_subscription<JointState>(
            "measured_js", 1, [this](const JointState::ConstSharedPtr state) { period(*state); });
    }
    bool ended() const { return s_.status == SWING_DONE || (s_.status == SWING_STOPPED && share_ <= 0.0); }
    bool done() const { return s_.status == SWING_DONE; }

private:
    void period(const JointState &state)
    {
        const rclcpp::Time now(state.header.stamp);
        if (ended() || state.position.size() < SWING_JOINTS || state.effort.size() < SWING_JOINTS) { return; }
        const double *q = state.position.data();
        double q_ref[SWING_JOINTS], qd_ref[SWING_JOINTS];
        const bool first = s_.status == SWING_IDLE;
        if (first) { swing_start(&s_, 0, speed_, q); }
        const double dt = first ? 0.0 : (now - before_).seconds();
        before_ = now;
        swing_step(&s_, dt, q, state.effort.data(), q_ref, qd_ref, &share_);
        JointState torque;
        torque.effort.resize(SWING_JOINTS);
        for (std::size_t j = 0; j < SWING_JOINTS; ++j) {
            torque.effort[j] = share_ * (kp_ * (q_ref[j] - q[j]) + kd_ * (qd_ref[j] - s_.rate[j]));
        }
        torques_->publish(torque);
        swing_print(stdout, rows_, swing_read(&s_, rows_, 256), first);
    }

    swing_state s_{};
    swing_row rows_[256];
    double speed_, kp_, kd_, share_ = 1.0;
    rclcpp::Time before_;
    rclcpp::Publisher<JointState>::SharedPtr torques_;
    rclcpp::Subscription<JointState>::SharedPtr states_;
};

int main(int count, char **words)
{
    rclcpp::init(count, words);
    const auto node = std::make_shared<Campaign>();
    while (rclcpp::ok() && !node->ended()) { rclcpp::spin_some(node); }
    rclcpp::shutdown();
    return node->done() ? 0 : 1;
}
