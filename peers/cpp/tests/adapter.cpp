// Drives hapticnet.hpp by the lines of peers/conformance.
#include <cstring>
#include <iostream>
#include <sstream>

#include "hapticnet.hpp"

using namespace hapticnet;
using Bytes = std::vector<std::uint8_t>;
using Fields = std::vector<std::string>;

namespace {

Bytes bytes_of(const std::string &text)
{
    Bytes bytes;
    if (text == "-")
        return bytes;
    if (text.empty() || text.size() % 2 != 0 || text.find_first_not_of("0123456789abcdefABCDEF") != std::string::npos)
        throw Error("'" + text + "' is not pairs of hex digits");
    for (std::size_t i = 0; i < text.size(); i += 2)
        bytes.push_back(static_cast<std::uint8_t>(std::stoul(text.substr(i, 2), nullptr, 16)));
    return bytes;
}

template <class Range> std::string hex(const Range &bytes)
{
    static const char digits[] = "0123456789abcdef";
    std::string text;
    for (auto byte : bytes) {
        text += digits[static_cast<std::uint8_t>(byte) >> 4];
        text += digits[static_cast<std::uint8_t>(byte) & 15];
    }
    return text.empty() ? "-" : text;
}

long long integer(const std::string &text)
{
    std::size_t used = 0;
    const long long value = std::stoll(text, &used);
    if (used != text.size())
        throw Error("'" + text + "' is not an integer");
    return value;
}

double real(const std::string &text)
{
    const Bytes bytes = bytes_of(text);
    if (bytes.size() != 8)
        throw Error("'" + text + "' is not the 16 hex digits of a float");
    std::uint64_t bits = 0;
    for (auto byte : bytes)
        bits = bits << 8 | byte;
    double value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}

std::string text_of(double value)
{
    std::uint64_t bits;
    Bytes bytes;
    std::memcpy(&bits, &value, sizeof bits);
    for (unsigned shift = 64; shift > 0; shift -= 8)
        bytes.push_back(static_cast<std::uint8_t>(bits >> (shift - 8)));
    return hex(bytes);
}

std::string string_of(const std::string &text)
{
    const Bytes bytes = bytes_of(text);
    return {bytes.begin(), bytes.end()};
}

#ifdef HAPTICNET_HAS_SEALED
Key key_of(const std::string &text)
{
    const Bytes bytes = bytes_of(text);
    Key key{};
    if (bytes.size() != key.size() && text != "-")
        throw Error("a key has 32 bytes");
    std::copy(bytes.begin(), bytes.end(), key.begin());
    return key;
}
#endif

class Adapter {
  public:
    std::string run(const Fields &fields)
    {
        const std::string &command = fields.at(0);
        if (command == "features")
            return features();
        if (command == "random")
            return begin_random(bytes_of(fields.at(1)));
        if (command == "master")
            return make_master(fields);
        if (command == "slave")
            return make_slave(fields);
        if (master_)
            return run_master(command, fields);
        if (slave_)
            return run_slave(command, fields);
        throw Error("there is no node, or no such command");
    }

  private:
    static bool takes(const Request &request)
    {
        try {
            Master master(request);
            return true;
        } catch (const Error &) {
            return false;
        }
    }

    static bool has(const std::string &codec)
    {
        Request request;
        request.codec = codec;
        return takes(request);
    }

    static std::string also()
    {
        std::string keys;
        Request few, announced, predicted;
        few.position_share = 0.25;
        announced.announced = predicted.predicted = true;
        keys += takes(few) ? ",share" : "";
        keys += takes(announced) ? ",announced" : "";
        keys += takes(predicted) ? ",predicted" : "";
        return keys.empty() ? "-" : keys.substr(1);
    }

    static std::string features()
    {
        std::string codecs;
#define NAME_OF(symbol, name, parameters) name,
        for (const std::string codec : {HN_CODECS(NAME_OF)})
            // Like the codecs that follow the hand, hapticnet's master bounds this one: without that, they differ.
            if (has(codec) && (codec != "velocity-adaptive" || has("motion-predictive")))
                codecs += (codecs.empty() ? "" : ",") + codec;
#ifdef HAPTICNET_HAS_SEALED
        const std::string sealed = "master,slave";
#else
        const std::string sealed = "-";
#endif
        return "language=C++ roles=master,slave codecs=" + codecs + " slave_codecs=deadband,raw sealed=" + sealed +
               " axes=" + std::to_string(HN_MOST_AXES) + " also=" + also();
    }

    std::string begin_random(const Bytes &bytes)
    {
        if (bytes.empty() || bytes.size() % 4 != 0)
            throw Error("random takes words of 4 bytes");
        words_.clear();
        word_ = 0;
        for (std::size_t i = 0; i < bytes.size(); i++) {
            if (i % 4 == 0)
                words_.push_back(0);
            words_.back() = words_.back() << 8 | bytes[i];
        }
        return "";
    }

    Random random()
    {
        return [this] { return words_.empty() ? 0 : words_[word_ + 1 < words_.size() ? word_++ : word_]; };
    }

    std::string make_master(const Fields &fields)
    {
        Request request;
        if (fields.size() < 8)
            throw Error("a key of master is missing");
        for (std::size_t i = 1; i < fields.size(); i++) {
            const auto equals = fields[i].find('=');
            const std::string key = fields[i].substr(0, equals);
            const std::string value = equals == std::string::npos ? "" : fields[i].substr(equals + 1);
            if (key == "codec")
                request.codec = value;
            else if (key == "name")
                request.name = string_of(value);
            else if (key == "axes")
                request.axes = static_cast<unsigned>(integer(value));
            else if (key == "rate")
                request.rate_hz = real(value);
            else if (key == "weber")
                request.weber_fraction = real(value);
            else if (key == "floor")
                request.floor_n = real(value);
            else if (key == "multiplier")
                request.multiplier = real(value);
            else if (key == "share")
                request.position_share = real(value);
            else if (key == "announced")
                request.announced = value == "1";
            else if (key == "predicted")
                request.predicted = value == "1";
            else if (key.substr(0, 2) == "p.")
                request.parameters.emplace_back(key.substr(2), real(value));
            else
                throw Error("'" + key + "' is not a key of master");
        }
        auto made = std::make_unique<Master>(request, random());
        axes_ = request.axes;
        master_ = std::move(made);
        slave_.reset();
        return "";
    }

    std::string make_slave(const Fields &fields)
    {
        std::string scene;
        long long axes = 1;
        if (fields.size() != 3)
            throw Error("slave has two keys, scene and axes");
        for (std::size_t i = 1; i < fields.size(); i++) {
            if (fields[i].rfind("scene=", 0) == 0)
                scene = string_of(fields[i].substr(6));
            else if (fields[i].rfind("axes=", 0) == 0)
                axes = integer(fields[i].substr(5));
            else
                throw Error("'" + fields[i] + "' is not a key of slave");
        }
        auto made = std::make_unique<Slave>(scene, static_cast<unsigned>(axes), random());
        axes_ = static_cast<unsigned>(axes);
        slave_ = std::move(made);
        master_.reset();
        return "";
    }

    Vector vector_of(const Fields &fields, std::size_t first) const
    {
        Vector vector{};
        if (fields.size() != first + axes_)
            throw Error("a float for each axis is missing, or there are too many");
        for (unsigned i = 0; i < axes_; i++)
            vector[i] = real(fields[first + i]);
        return vector;
    }

    std::string text_of_vector(const Vector &vector) const
    {
        std::string text = text_of(vector[0]);
        for (unsigned i = 1; i < axes_; i++)
            text += " " + text_of(vector[i]);
        return text;
    }

    static std::string text_of_counts(const hn_counts &counts)
    {
        return std::to_string(counts.malformed) + " " + std::to_string(counts.stray) + " " +
               std::to_string(counts.too_old);
    }

    std::string run_master(const std::string &command, const Fields &fields)
    {
        static const char *const states[] = {"connecting", "established", "stale", "closing", "closed"};
        if (command == "tick") {
            const Vector position_m = vector_of(fields, 2);
            master_->tick(position_m, Time(integer(fields[1])));
        } else if (command == "force") {
            return text_of_vector(master_->force(Time(integer(fields.at(1)))));
        } else if (command == "send") {
            std::string sent;
            while (const auto datagram = master_->send())
                sent += (sent.empty() ? "" : " ") + hex(datagram);
            return sent;
        } else if (command == "receive") {
            const Bytes data = bytes_of(fields.at(2));
            master_->receive(data.data(), data.size(), Time(integer(fields[1])));
        } else if (command == "close") {
            const std::string reason = string_of(fields.at(2));
            master_->close(reason.c_str(), Time(integer(fields[1])));
        } else if (command == "state") {
            return states[static_cast<unsigned>(master_->state())];
        } else if (command == "reason") {
            const auto reason = master_->reason();
            return std::to_string(reason.code) + " " + hex(reason.text);
        } else if (command == "scene") {
            return hex(master_->scene());
        } else if (command == "counts") {
            return text_of_counts(master_->counts());
#ifdef HAPTICNET_HAS_SEALED
        } else if (command == "seal") {
            master_->seal(PrivateKey(key_of(fields.at(1)), key_of(fields.at(3))), key_of(fields.at(2)));
#endif
        } else {
            throw Error("a master has no command '" + command + "'");
        }
        return "";
    }

    std::string run_slave(const std::string &command, const Fields &fields)
    {
        if (command == "receive") {
            const Bytes data = bytes_of(fields.at(2)), address = bytes_of(fields.at(3));
            if (address.empty() || address.size() > HN_ADDRESS_BYTES)
                throw Error("an address has 1 to 28 bytes");
            const Time now(integer(fields[1]));
            return hex(slave_->receive(data.data(), data.size(), address.data(), address.size(), now));
        }
        if (command == "position") {
            const auto position_m = slave_->position();
            return position_m ? text_of_vector(*position_m) : "-";
        }
        if (command == "answer") {
            const Vector force_n = vector_of(fields, 2);
            return hex(slave_->answer(force_n, Time(integer(fields[1]))));
        }
        if (command == "close") {
            const std::string reason = string_of(fields.at(2));
            return hex(slave_->close(reason.c_str(), static_cast<unsigned>(integer(fields[1]))));
        }
        if (command == "address") {
            const auto [address, size] = slave_->master();
            const auto *at = static_cast<const std::uint8_t *>(address);
            return hex(Bytes(at, at + size));
        }
        if (command == "counts")
            return text_of_counts(slave_->counts());
#ifdef HAPTICNET_HAS_SEALED
        if (command == "seal") {
            std::vector<Listed> masters;
            for (std::size_t i = 2; i < fields.size(); i += 2)
                masters.push_back({key_of(fields[i]), key_of(fields.at(i + 1))});
            slave_->seal(PrivateKey(key_of(fields.at(1))), masters);
            return "";
        }
#endif
        throw Error("a slave has no command '" + command + "'");
    }

    std::vector<std::uint32_t> words_;
    std::size_t word_ = 0;
    unsigned axes_ = 1;
    std::unique_ptr<Master> master_;
    std::unique_ptr<Slave> slave_;
};

} // namespace

int main()
{
    Adapter adapter;
    std::string line;
    while (std::getline(std::cin, line)) {
        Fields fields;
        std::istringstream words(line);
        for (std::string word; words >> word;)
            fields.push_back(word);
        try {
            const std::string answer = adapter.run(fields);
            std::cout << (answer.empty() ? "ok" : "ok " + answer) << std::endl;
        } catch (const Error &error) {
            std::cout << "error " << error.what() << std::endl;
        } catch (const std::exception &) {
            std::cout << "error a field is missing or is not a number" << std::endl;
        }
    }
}
