// Sends COUNT pings, one after the other, PERIOD ms apart; prints "state milliseconds" for each.
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <thread>

#include <actionlib/client/simple_action_client.h>
#include <network_analysis/PingAction.h>
#include <ros/ros.h>

int main(int argc, char** argv) {
  ros::init(argc, argv, "cpp_ping_client", ros::init_options::AnonymousName);
  if (argc < 3) {
    std::fprintf(stderr, "usage: ping_client COUNT PERIOD_MS\n");
    return 2;
  }
  const int count = std::atoi(argv[1]);
  const auto period = std::chrono::milliseconds(std::atoi(argv[2]));
  actionlib::SimpleActionClient<network_analysis::PingAction> client("Ping", true);
  if (!client.waitForServer(ros::Duration(10.0))) {
    std::fprintf(stderr, "ping_client: no server in 10 s\n");
    return 1;
  }
  network_analysis::PingGoal goal;
  goal.inp = true;
  for (int i = 0; i < count && ros::ok(); ++i) {
    const auto began = std::chrono::steady_clock::now();
    client.sendGoal(goal);
    const bool done = client.waitForResult(ros::Duration(2.0));
    const std::chrono::duration<double, std::milli> took = std::chrono::steady_clock::now() - began;
    std::printf("%s %.4f\n", done ? client.getState().toString().c_str() : "LOST", took.count());
    std::fflush(stdout);
    std::this_thread::sleep_until(began + period);
  }
  return 0;
}
