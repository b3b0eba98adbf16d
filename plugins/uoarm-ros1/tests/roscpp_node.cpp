// A node of roscpp for tests: a talker, an echo, a service and an action, and a client of each.
#include <actionlib/TwoIntsAction.h>
#include <actionlib/client/simple_action_client.h>
#include <actionlib/server/simple_action_server.h>
#include <ros/ros.h>
#include <roscpp/GetLoggers.h>
#include <std_msgs/Float64MultiArray.h>
#include <std_msgs/String.h>

#include <iostream>

typedef actionlib::SimpleActionServer<actionlib::TwoIntsAction> Server;
typedef actionlib::SimpleActionClient<actionlib::TwoIntsAction> Client;

ros::Publisher echo;

void onMessage(const std_msgs::Float64MultiArray::ConstPtr& message) { echo.publish(message); }

bool onCall(roscpp::GetLoggers::Request&, roscpp::GetLoggers::Response& response) {
  for (const char* name : {"first", "second"}) {
    roscpp::Logger logger;
    logger.name = name;
    logger.level = "of roscpp";
    response.loggers.push_back(logger);
  }
  return true;
}

void onGoal(const actionlib::TwoIntsGoalConstPtr& goal, Server* server) {
  actionlib::TwoIntsResult result;
  result.sum = goal->a + goal->b;
  server->setSucceeded(result);
}

int main(int argc, char** argv) {
  ros::init(argc, argv, "cpp", ros::init_options::NoSigintHandler);
  ros::NodeHandle node;
  ros::AsyncSpinner spinner(2);
  ros::Publisher talker = node.advertise<std_msgs::String>("/cpp/latched", 10, true);
  std_msgs::String text;
  text.data = "of roscpp";
  talker.publish(text);
  echo = node.advertise<std_msgs::Float64MultiArray>("/cpp/out", 1000);
  ros::Subscriber in = node.subscribe("/cpp/in", 1000, onMessage);
  ros::ServiceServer service = node.advertiseService("/cpp/loggers", onCall);
  Server server(node, "/cpp/add", [&server](const actionlib::TwoIntsGoalConstPtr& goal) { onGoal(goal, &server); }, false);
  server.start();
  spinner.start();
  std::cout << "{\"is\": \"ready\"}" << std::endl;
  std::string line;
  while (std::getline(std::cin, line)) {
    if (line.find("call") != std::string::npos) {
      roscpp::GetLoggers asked;
      bool done = ros::service::call("/ours/loggers", asked);
      std::string said = done && asked.response.loggers.size() == 1 ? asked.response.loggers[0].name : "failed";
      std::cout << "{\"is\": \"" << said << "\"}" << std::endl;
    } else if (line.find("goal") != std::string::npos) {
      Client client("/ours/add", true);
      actionlib::TwoIntsGoal goal;
      goal.a = 40;
      goal.b = 2;
      client.waitForServer();
      client.sendGoalAndWait(goal);
      std::cout << "{\"is\": [\"" << client.getState().toString() << "\", " << client.getResult()->sum << "]}" << std::endl;
    } else {
      std::cout << "{\"is\": null}" << std::endl;
    }
  }
  return 0;
}
