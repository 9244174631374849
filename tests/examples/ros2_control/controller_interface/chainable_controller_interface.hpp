// Stand-in for what the example uses of ros2_control, with its signatures (controller_interface of Jazzy), without ROS.
#pragma once
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

namespace rclcpp
{
struct Time {};
class Duration
{
public:
  explicit Duration(double seconds) : seconds_(seconds) {}
  double seconds() const { return seconds_; }
private:
  double seconds_;
};
struct Parameter
{
  std::string text;
  double number{};
  std::string as_string() const { return text; }
  double as_double() const { return number; }
};
}  // namespace rclcpp

namespace rclcpp_lifecycle
{
struct State {};
struct LifecycleNode
{
  std::map<std::string, rclcpp::Parameter> parameters;
  rclcpp::Parameter get_parameter(const std::string & name) const { return parameters.at(name); }
  const char * get_name() const { return "knee_contact"; }
};
}  // namespace rclcpp_lifecycle

namespace hardware_interface
{
class StateInterface
{
public:
  StateInterface(const std::string & prefix, const std::string & name, double * value)
  : name_(prefix + "/" + name), value_(value) {}
  const std::string & get_name() const { return name_; }
  std::optional<double> get_optional() const { return value_ ? std::optional<double>(*value_) : std::nullopt; }
private:
  std::string name_;
  double * value_;
};
using CommandInterface = StateInterface;
using LoanedStateInterface = StateInterface;
}  // namespace hardware_interface

namespace controller_interface
{
enum class return_type { OK, ERROR };
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };
struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names;
};
class ChainableControllerInterface
{
public:
  virtual ~ChainableControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  return_type update(const rclcpp::Time & time, const rclcpp::Duration & period)
  {
    return update_and_write_commands(time, period);
  }
  std::vector<hardware_interface::StateInterface> export_state_interfaces() { return on_export_state_interfaces(); }
  std::vector<hardware_interface::LoanedStateInterface> state_interfaces_;
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> get_node() const { return node_; }

protected:
  virtual std::vector<hardware_interface::StateInterface> on_export_state_interfaces() = 0;
  virtual std::vector<hardware_interface::CommandInterface> on_export_reference_interfaces() = 0;
  virtual return_type update_reference_from_subscribers(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual return_type update_and_write_commands(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  template <typename T>
  void auto_declare(const std::string & name, const T & value)
  {
    rclcpp::Parameter & made = node_->parameters[name];
    if constexpr (std::is_same<T, std::string>::value) made.text = value;
    else made.number = value;
  }

private:
  std::shared_ptr<rclcpp_lifecycle::LifecycleNode> node_ = std::make_shared<rclcpp_lifecycle::LifecycleNode>();
};
}  // namespace controller_interface
