// Gravity and friction compensation of @{title} as a controller of ros2_control (Humble and later).
// It reads position and velocity of every joint and writes its effort.
#include "@{name}.h"

#include "controller_interface/controller_interface.hpp"
#include "pluginlib/class_list_macros.hpp"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <exception>
#include <string>
#include <vector>

namespace @{name}_controller {

constexpr std::size_t size = @{NAME}_COORDINATES;
using Values = std::array<@{name}_real, size>;
using Result = controller_interface::CallbackReturn;

// ros2_control renamed these: the first that compiles is taken.
template <typename Interface>
auto read(const Interface &from, int) -> decltype(from.get_optional().value_or(0.0))
{
    return from.get_optional().value_or(std::nan(""));
}

template <typename Interface>
double read(const Interface &from, long)
{
    return from.get_value();
}

class Compensation : public controller_interface::ControllerInterface {
public:
    Result on_init() override
    {
        try {
            auto_declare<std::vector<std::string>>("joints", {});
            auto_declare<std::vector<double>>("effort_limits", {});
            auto_declare<double>("gravity_share", 1.0);
            auto_declare<double>("friction_share", 0.5);
        } catch (const std::exception &) {
            return Result::ERROR;
        }
        return Result::SUCCESS;
    }

    controller_interface::InterfaceConfiguration command_interface_configuration() const override
    {
        return wanted({"effort"});
    }

    controller_interface::InterfaceConfiguration state_interface_configuration() const override
    {
        return wanted({"position", "velocity"});
    }

    Result on_configure(const rclcpp_lifecycle::State &) override
    {
        joints_ = get_node()->get_parameter("joints").as_string_array();
        limits_ = get_node()->get_parameter("effort_limits").as_double_array();
        gravity_ = static_cast<@{name}_real>(get_node()->get_parameter("gravity_share").as_double());
        friction_ = static_cast<@{name}_real>(get_node()->get_parameter("friction_share").as_double());
        const bool limited = std::all_of(limits_.begin(), limits_.end(), [](double most) { return most > 0.0; });
        if (joints_.size() != size || limits_.size() != size || !limited) {
            return Result::ERROR;  // a name and an effort above zero for each of the coordinates
        }
        @{name}_init(&model_, @{name}_beta);
        return Result::SUCCESS;
    }

    Result on_deactivate(const rclcpp_lifecycle::State &) override
    {
        send(Values{});
        return Result::SUCCESS;
    }

    controller_interface::return_type update(const rclcpp::Time &, const rclcpp::Duration &) override
    {
        Values q{}, qd{}, effort{}, friction{};
        bool known = true;
        for (std::size_t i = 0; i < size; ++i) {
            q[i] = static_cast<@{name}_real>(read(state_interfaces_[2 * i], 0));
            qd[i] = static_cast<@{name}_real>(read(state_interfaces_[2 * i + 1], 0));
            known = known && std::isfinite(q[i]) && std::isfinite(qd[i]);
        }
        if (!known) {
            send(Values{});
            return controller_interface::return_type::ERROR;
        }
        @{name}_gravity(&model_, q.data(), effort.data());
        @{name}_friction_compensation(&model_, qd.data(), friction_, friction.data());
        for (std::size_t i = 0; i < size; ++i) {
            effort[i] = gravity_ * effort[i] + friction[i];
        }
        send(effort);
        return controller_interface::return_type::OK;
    }

private:
    controller_interface::InterfaceConfiguration wanted(const std::vector<std::string> &kinds) const
    {
        controller_interface::InterfaceConfiguration made;
        made.type = controller_interface::interface_configuration_type::INDIVIDUAL;
        for (const std::string &joint : joints_) {
            for (const std::string &kind : kinds) {
                made.names.push_back(joint + "/" + kind);
            }
        }
        return made;
    }

    void send(const Values &effort)
    {
        for (std::size_t i = 0; i < std::min(size, command_interfaces_.size()); ++i) {
            const double value = static_cast<double>(effort[i]);
            static_cast<void>(command_interfaces_[i].set_value(std::clamp(value, -limits_[i], limits_[i])));
        }
    }

    @{name}_model model_{};
    std::vector<std::string> joints_;
    std::vector<double> limits_;
    @{name}_real gravity_{};
    @{name}_real friction_{};
};

}  // namespace @{name}_controller

PLUGINLIB_EXPORT_CLASS(@{name}_controller::Compensation, controller_interface::ControllerInterface)
