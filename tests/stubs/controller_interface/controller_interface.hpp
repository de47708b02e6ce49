// What controllers use of ros2_control, in one header.
#pragma once
#include <map>
#include <memory>
#include <string>
#include <vector>
#include "rclcpp/rclcpp.hpp"
namespace rclcpp_lifecycle { struct State {}; }
struct Parameter {
    std::vector<std::string> s; std::vector<double> d; double x = 0;
    std::vector<std::string> as_string_array() const { return s; }
    std::vector<double> as_double_array() const { return d; }
    double as_double() const { return x; }
};
struct Node { std::map<std::string, Parameter> of; Parameter get_parameter(const std::string &n) { return of[n]; } };
struct State_ { double v; double get_value() const { return v; } };
struct Command_ { double v; void set_value(double x) { v = x; } };
namespace controller_interface {
enum class CallbackReturn { SUCCESS, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { INDIVIDUAL };
struct InterfaceConfiguration { interface_configuration_type type; std::vector<std::string> names; };
class ControllerInterface {
public:
    virtual ~ControllerInterface() = default;
    virtual CallbackReturn on_init() = 0;
    virtual InterfaceConfiguration command_interface_configuration() const = 0;
    virtual InterfaceConfiguration state_interface_configuration() const = 0;
    virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) { return CallbackReturn::SUCCESS; }
    virtual return_type update(const rclcpp::Time &, const rclcpp::Duration &) = 0;
    std::shared_ptr<Node> node_ = std::make_shared<Node>();
    std::shared_ptr<Node> get_node() const { return node_; }
    template <typename T> void auto_declare(const std::string &, const T &) {}
    std::vector<State_> state_interfaces_;
    std::vector<Command_> command_interfaces_;
};
}
