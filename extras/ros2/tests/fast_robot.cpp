// A robot behind another implementation of DDS: a spring of 400 N/m along z, in eProsima Fast DDS, as rmw_fastrtps is.
// It answers each servo_cp with measured_cf, and says at its end how many came and what the last one held.
// Usage: fast_robot DOMAIN NAMESPACE reliable|best. It ends with its input.
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <string>
#include <thread>

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

struct Message {  // a header, and six (wrench) or seven (pose) numbers
    int32_t sec = 0;
    uint32_t nanosec = 0;
    std::string frame_id;
    double values[7] = {0, 0, 0, 0, 0, 0, 1};
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
        return true;
    }

    std::function<uint32_t()> getSerializedSizeProvider(void*) override {
        return [this] { return m_typeSize; };
    }
    void* createData() override { return new Message; }
    void deleteData(void* data) override { delete static_cast<Message*>(data); }
    bool getKey(void*, eprosima::fastrtps::rtps::InstanceHandle_t*, bool) override { return false; }

private:
    int count_;
};

int main(int, char** argv) {
    const std::string space = std::string("rt") + argv[2];
    const auto reliability = std::strcmp(argv[3], "reliable") ? BEST_EFFORT_RELIABILITY_QOS : RELIABLE_RELIABILITY_QOS;
    auto* own = DomainParticipantFactory::get_instance()->create_participant(
        static_cast<DomainId_t>(std::atoi(argv[1])), PARTICIPANT_QOS_DEFAULT);
    TypeSupport pose(new Type("geometry_msgs::msg::dds_::PoseStamped_", 7));
    TypeSupport wrench(new Type("geometry_msgs::msg::dds_::WrenchStamped_", 6));
    pose.register_type(own);
    wrench.register_type(own);

    DataReaderQos wanted = DATAREADER_QOS_DEFAULT;
    wanted.reliability().kind = reliability;
    DataWriterQos offered = DATAWRITER_QOS_DEFAULT;
    offered.reliability().kind = reliability;
    auto* commands = own->create_subscriber(SUBSCRIBER_QOS_DEFAULT)->create_datareader(
        own->create_topic(space + "/servo_cp", pose.get_type_name(), TOPIC_QOS_DEFAULT), wanted);
    auto* publisher = own->create_publisher(PUBLISHER_QOS_DEFAULT);
    auto* places = publisher->create_datawriter(
        own->create_topic(space + "/measured_cp", pose.get_type_name(), TOPIC_QOS_DEFAULT), offered);
    auto* forces = publisher->create_datawriter(
        own->create_topic(space + "/measured_cf", wrench.get_type_name(), TOPIC_QOS_DEFAULT), offered);

    Message at, felt;
    at.values[2] = 0.1;  // where the robot is when it is switched on
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
        const auto now = std::chrono::system_clock::now().time_since_epoch();
        const auto ns = std::chrono::duration_cast<std::chrono::nanoseconds>(now).count();
        at.sec = felt.sec = static_cast<int32_t>(ns / 1000000000);
        at.nanosec = felt.nanosec = static_cast<uint32_t>(ns % 1000000000);
        felt.values[2] = 400.0 * (0.1 - at.values[2]);
        at.frame_id = felt.frame_id = "fast";
        places->write(&at);
        forces->write(&felt);
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    input.join();
    std::printf("%ld %.6f %.6f %.6f\n", received, at.values[0], at.values[2], at.values[6]);
    return 0;
}
