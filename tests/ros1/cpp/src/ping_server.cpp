// Answers the ping action by actionlib's simple server: the kind of peer the 2021 package starts on the station.
#include <actionlib/server/simple_action_server.h>
#include <network_analysis/PingAction.h>
#include <ros/ros.h>

using Server = actionlib::SimpleActionServer<network_analysis::PingAction>;

int main(int argc, char** argv) {
  ros::init(argc, argv, "cpp_ping_server");
  ros::NodeHandle node;
  Server* self = nullptr;
  Server server(
      node, "Ping",
      [&self](const network_analysis::PingGoalConstPtr& goal) {
        if (self->isPreemptRequested()) {
          self->setPreempted();
          return;
        }
        network_analysis::PingFeedback feedback;
        feedback.fb = goal->inp;
        self->publishFeedback(feedback);
        network_analysis::PingResult result;
        result.outp = goal->inp;
        self->setSucceeded(result);
      },
      false);
  self = &server;
  server.start();
  ros::spin();
  return 0;
}
