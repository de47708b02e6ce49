// Plays a campaign of `haptid excite --player swing.c` as a controller of ros2_control with effort commands.
//
// Parameters: joints (in the order of the player's first comment), kp, kd, speed. rows() hands the recorded rows to a
// thread that is not real-time; they are also in the ring buffer when the controller is deactivated.
#include <controller_interface/controller_interface.hpp>
#include <string>
#include <vector>
#include "swing.c"

namespace haptid_campaign {
using controller_interface::CallbackReturn;
using controller_interface::InterfaceConfiguration;
using controller_interface::interface_configuration_type;
using controller_interface::return_type;

class Campaign : public controller_interface::ControllerInterface {
public:
    CallbackReturn on_init() override
    {
        auto_declare<std::vector<std::string>>("joints", {});
        auto_declare<double>("kp", 5.0);
        auto_declare<double>("kd", 0.2);
        auto_declare<double>("speed", 0.2);
        return CallbackReturn::SUCCESS;
    }
    InterfaceConfiguration command_interface_configuration() const override { return of("/effort"); }
    InterfaceConfiguration state_interface_configuration() const override { return of("/position"); }
    CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
    {
        const auto node = get_node();
        joints_ = node->get_parameter("joints").as_string_array();
        kp_ = node->get_parameter("kp").as_double();
        kd_ = node->get_parameter("kd").as_double();
        speed_ = node->get_parameter("speed").as_double();
        return joints_.size() == SWING_JOINTS ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
    }
    CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
    {
        double q[SWING_JOINTS];
        positions(q);
        swing_start(&s_, 0, speed_, q);
        return s_.status == SWING_APPROACHING ? CallbackReturn::SUCCESS : CallbackReturn::ERROR;
    }
    CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override
    {
        for (auto &command : command_interfaces_) { command.set_value(0.0); }
        return CallbackReturn::SUCCESS;
    }
    return_type update(const rclcpp::Time &, const rclcpp::Duration &period) override
    {
        double q[SWING_JOINTS], q_ref[SWING_JOINTS], qd_ref[SWING_JOINTS], share;
        positions(q);
        swing_step(&s_, period.seconds(), q, tau_, q_ref, qd_ref, &share);
        for (std::size_t j = 0; j < SWING_JOINTS; ++j) {
            tau_[j] = share * (kp_ * (q_ref[j] - q[j]) + kd_ * (qd_ref[j] - s_.rate[j]));
            command_interfaces_[j].set_value(tau_[j]);
        }
        return return_type::OK;
    }
    unsigned rows(swing_row *to, unsigned many) { return swing_read(&s_, to, many); }
    bool done() const { return s_.status == SWING_DONE; }

private:
    InterfaceConfiguration of(const std::string &interface) const
    {
        InterfaceConfiguration made{interface_configuration_type::INDIVIDUAL, {}};
        for (const auto &joint : joints_) { made.names.push_back(joint + interface); }
        return made;
    }
    void positions(double *q) const
    {
        for (std::size_t j = 0; j < SWING_JOINTS; ++j) { q[j] = state_interfaces_[j].get_value(); }
    }
    std::vector<std::string> joints_;
    double kp_ = 0.0, kd_ = 0.0, speed_ = 0.2, tau_[SWING_JOINTS] = {};
    swing_state s_{};
};
}  // namespace haptid_campaign

#include <pluginlib/class_list_macros.hpp>
PLUGINLIB_EXPORT_CLASS(haptid_campaign::Campaign, controller_interface::ControllerInterface)
