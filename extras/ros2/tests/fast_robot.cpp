// A robot behind another implementation of DDS: a spring of 400 N/m along z and one of 0.5 N·m/rad about it, and a jaw
// that closes on 30 mm with 200 N/m, in eProsima Fast DDS, as rmw_fastrtps is.
// It answers each servo_cp with measured_cf and each servo_jp with measured_js, and says at its end how many servo_cp
// came and what the last ones held.
// Usage: fast_robot DOMAIN NAMESPACE reliable|best. It ends with its input.
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>
#include <vector>

#include <fastcdr/Cdr.h>
#include <fastcdr/FastBuffer.h>
#include <fastdds/dds/domain/DomainParticipant.hpp>
#include <fastdds/dds/domain/DomainParticipantFactory.hpp>
#include <fastdds/dds/publisher/DataWriter.hpp>
#include <fastdds/dds/publisher/Publisher.hpp>
#include <fastdds/dds/subscriber/DataReader.hpp>
#include <fastdds/dds/subscriber/SampleInfo.hpp>
#include <fastdds/dds/subscriber/Subscriber.hpp>
#include <fastdds/dds/topic/TopicDataType.hpp>

using namespace eprosima::fastdds::dds;
using eprosima::fastcdr::Cdr;
using eprosima::fastcdr::FastBuffer;

struct Message {  // a header, and six (wrench) or seven (pose) numbers, or what a joint has
    int32_t sec = 0;
    uint32_t nanosec = 0;
    std::string frame_id;
    double values[7] = {0, 0, 0, 0, 0, 0, 1};
    std::vector<std::string> name;
    std::vector<double> position, velocity, effort;
};

class Type : public TopicDataType {
public:
    Type(const char* name, int count) : count_(count) {
        setName(name);
        m_typeSize = 4 + 512;
        m_isGetKeyDefined = false;
    }

    bool serialize(void* data, eprosima::fastrtps::rtps::SerializedPayload_t* payload) override {
        auto* message = static_cast<Message*>(data);
        FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->max_size);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        payload->encapsulation = cdr.endianness() == Cdr::BIG_ENDIANNESS ? CDR_BE : CDR_LE;
        cdr.serialize_encapsulation();
        cdr << message->sec << message->nanosec << message->frame_id;
        for (int each = 0; each < count_; ++each) cdr << message->values[each];
        if (!count_) cdr << message->name << message->position << message->velocity << message->effort;
        payload->length = static_cast<uint32_t>(cdr.getSerializedDataLength());
        return true;
    }

    bool deserialize(eprosima::fastrtps::rtps::SerializedPayload_t* payload, void* data) override {
        auto* message = static_cast<Message*>(data);
        FastBuffer buffer(reinterpret_cast<char*>(payload->data), payload->length);
        Cdr cdr(buffer, Cdr::DEFAULT_ENDIAN, Cdr::DDS_CDR);
        cdr.read_encapsulation();
        cdr >> message->sec >> message->nanosec >> message->frame_id;
        for (int each = 0; each < count_; ++each) cdr >> message->values[each];
        if (!count_) cdr >> message->name >> message->position >> message->velocity >> message->effort;
        return true;
    }

    std::function<uint32_t()> getSerializedSizeProvider(void*) override {
        return [this] { return m_typeSize; };
    }
    void* createData() override { return new Message; }
    void deleteData(void* data) override { delete static_cast<Message*>(data); }
    bool getKey(void*, eprosima::fastrtps::rtps::InstanceHandle_t*, bool) override { return false; }

private:
    int count_;  // 0: a joint
};

int main(int, char** argv) {
    const std::string space = std::string("rt") + argv[2];
    const auto reliability = std::strcmp(argv[3], "reliable") ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
    auto* own = DomainParticipantFactory::get_instance()->create_participant(
        static_cast<DomainId_t>(std::atoi(argv[1])), PARTICIPANT_QOS_DEFAULT);
    TypeSupport pose(new Type("geometry_msgs::msg::dds_::PoseStamped_", 7));
    TypeSupport wrench(new Type("geometry_msgs::msg::dds_::WrenchStamped_", 6));
    TypeSupport joint(new Type("sensor_msgs::msg::dds_::JointState_", 0));
    pose.register_type(own);
    wrench.register_type(own);
    joint.register_type(own);

    DataReaderQos wanted = DATAREADER_QOS_DEFAULT;
    wanted.reliability().kind = reliability;
    DataWriterQos offered = DATAWRITER_QOS_DEFAULT;
    offered.reliability().kind = reliability;
    auto* subscriber = own->create_subscriber(SUBSCRIBER_QOS_DEFAULT);
    auto* publisher = own->create_publisher(PUBLISHER_QOS_DEFAULT);
    const auto topic = [&](const char* name, TypeSupport& type) {
        return own->create_topic(space + name, type.get_type_name(), TOPIC_QOS_DEFAULT);
    };
    auto* commands = subscriber->create_datareader(topic("/servo_cp", pose), wanted);
    auto* openings = subscriber->create_datareader(topic("/jaw/servo_jp", joint), wanted);
    auto* places = publisher->create_datawriter(topic("/measured_cp", pose), offered);
    auto* forces = publisher->create_datawriter(topic("/measured_cf", wrench), offered);
    auto* jaws = publisher->create_datawriter(topic("/jaw/measured_js", joint), offered);

    Message at, felt, jaw;
    at.values[2] = 0.1;  // where the robot is when it is switched on
    jaw.name = {"jaw"};
    jaw.position = {0.04};
    long received = 0;
    std::atomic<bool> ends{false};
    std::thread input([&ends] {
        std::getchar();
        ends = true;
    });
    while (!ends) {
        SampleInfo info;
        Message command;
        while (commands->take_next_sample(&command, &info) == ReturnCode_t::RETCODE_OK) {
            if (info.valid_data) {
                at = command;
                ++received;
            }
        }
        while (openings->take_next_sample(&command, &info) == ReturnCode_t::RETCODE_OK) {
            if (info.valid_data && command.position.size() == 1) jaw.position = command.position;
        }
        const auto now = std::chrono::system_clock::now().time_since_epoch();
        const auto ns = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
        at.sec = felt.sec = jaw.sec = static_cast<int32_t>(ns / 1000000000);
        at.nanosec = felt.nanosec = jaw.nanosec = static_cast<uint32_t>(ns % 1000000000);
        felt.values[2] = 400.0 * (0.1 - at.values[2]);
        felt.values[5] = -0.5 * 2.0 * std::atan2(at.values[5], at.values[6]);
        jaw.effort = {std::fmin(200.0 * (jaw.position[0] - 0.03), 0.0)};  // of the drive, which closes it
        at.frame_id = felt.frame_id = "fast";
        places->write(&at);
        forces->write(&felt);
        jaws->write(&jaw);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    input.join();
    std::printf("%ld", received);
    for (const double each : {at.values[0], at.values[2], at.values[5], at.values[6], jaw.position[0]}) {
        std::printf(" %.6f", each);
    }
    std::printf("\n");
    return 0;
}
