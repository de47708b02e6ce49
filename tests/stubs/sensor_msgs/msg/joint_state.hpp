#pragma once
#include <memory>
#include <vector>
#include "rclcpp/rclcpp.hpp"
namespace sensor_msgs { namespace msg {
struct JointState {
    using ConstSharedPtr = std::shared_ptr<const JointState>;
    struct { stub::Stamp stamp; } header;
    std::vector<double> position, velocity, effort;
};
} }
