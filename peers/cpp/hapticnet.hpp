/* hapticnet for C++17: a master's and a slave's end of the hapticnet protocol, as objects.
 *
 * It is the C library (hapticnet.h) in one header: no input or output, no clock. Only constructors, `seal` and
 * what reads keys throw, and only `Error`, with the library's text; what a control loop calls is noexcept and allocates
 * nothing. So an object that exists is valid, and the loop has no error to check. */
#ifndef HAPTICNET_HPP
#define HAPTICNET_HPP

#include <algorithm>
#include <array>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <random>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "hapticnet.h"
#if __has_include("hapticnet_keys.h")
#include "hapticnet_keys.h"
#define HAPTICNET_HAS_SEALED 1
#endif

namespace hapticnet {

/* What was wrong with a request, a key or a file. */
class Error : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/* Positions [m] and forces [N]; what is beyond the axes that were asked for is not used, and zero in forces. */
using Vector = std::array<double, HN_MOST_AXES>;

/* A time of one monotonic clock, the program's own. */
using Time = std::chrono::microseconds;

inline Time now()
{
    return std::chrono::duration_cast<Time>(std::chrono::steady_clock::now().time_since_epoch());
}

/* Returns 32 unpredictable bits, for session numbers, cookies and keys of a handshake. If it throws while a
 * node runs, the program ends. */
using Random = std::function<std::uint32_t()>;

/* The system's: std::random_device, which is unpredictable with libstdc++, libc++ and Microsoft's library. */
inline Random system_random()
{
    auto device = std::make_shared<std::random_device>();
    return [device] { return static_cast<std::uint32_t>((*device)()); };
}

/* What a master asks for. The defaults are hapticnet's own. */
struct Request {
    std::string codec = "deadband";
    std::string name = "C++";                                   /* who asks; printable UTF-8, at most 64 bytes */
    std::vector<std::pair<std::string, double>> parameters = {}; /* of the codec; others have their defaults */
    double weber_fraction = HN_DEFAULT_WEBER_FRACTION;          /* the just-noticeable difference of the person */
    double floor_n = HN_DEFAULT_FLOOR_N;
    double multiplier = HN_DEFAULT_MULTIPLIER;
    double rate_hz = HN_DEFAULT_RATE_HZ; /* positions a second; 20 to 100000 */
    unsigned axes = 1;                   /* 1 to 3 */
    double position_share = 0.0;         /* of that difference, for few positions: 0.01 to 0.9; 0: every one is sent */
    bool announced = false;              /* whether to render contact that the slave announces */
    bool predicted = false;              /* whether the slave predicts the hand */
};

enum class State { connecting, established, stale, closing, closed };

struct Reason {
    unsigned code; /* HN_CODE_...; 0 also if there is none yet */
    std::string text;
};

/* A datagram to send; false if there is none. */
class Datagram {
  public:
    explicit operator bool() const noexcept { return size_ > 0; }
    const std::uint8_t *data() const noexcept { return bytes_.data(); }
    std::size_t size() const noexcept { return size_; }
    const std::uint8_t *begin() const noexcept { return data(); }
    const std::uint8_t *end() const noexcept { return data() + size_; }

  private:
    friend class Master;
    friend class Slave;
    std::array<std::uint8_t, HN_DATAGRAM_BYTES> bytes_{};
    std::size_t size_ = 0;
};

/* A buffer to receive into should have this size: one byte more than a datagram, so that a longer one is seen. */
inline constexpr std::size_t RECEIVE_BYTES = HN_DATAGRAM_BYTES + 1;

namespace detail {

inline std::uint32_t draw(void *random) noexcept
{
    return (*static_cast<Random *>(random))();
}

/* Say what is wrong with a request, with the value that it has. */
inline Error error(const hn_request &request, const char *wrong)
{
    std::array<char, 600> text{};
    return Error(hn_say_wrong(&request, wrong, text.data(), text.size()));
}

/* Overwrite a secret that is not used again, which a compiler would leave out. */
inline void wipe(void *secret, std::size_t size) noexcept
{
    for (volatile auto *at = static_cast<unsigned char *>(secret); size > 0; size--)
        *at++ = 0;
}

} // namespace detail

#ifdef HAPTICNET_HAS_SEALED

using Key = std::array<std::uint8_t, 32>;

/* A host's own key, and the one that it shares with its peer: zeros if there is none. It overwrites itself. */
struct PrivateKey {
    Key own{}, psk{};
    PrivateKey() = default;
    explicit PrivateKey(const Key &own_key, const Key &shared = {}) : own(own_key), psk(shared) {}
    PrivateKey(const PrivateKey &) = default;
    PrivateKey &operator=(const PrivateKey &) = default;
    ~PrivateKey()
    {
        detail::wipe(own.data(), own.size());
        detail::wipe(psk.data(), psk.size());
    }
};

/* A master that a slave serves; `psk` as above. */
struct Listed {
    Key public_key{}, psk{};
};

/* Return a key that is written as 44 characters of base64. */
inline Key parse_key(const std::string &text)
{
    Key key{};
    if (!hn_parse_key(key.data(), text.c_str()))
        throw Error("a key is 44 characters of base64 that end in '=' (32 bytes); this has " +
                    std::to_string(text.size()) + " characters");
    return key;
}

inline std::string format_key(const Key &key)
{
    std::array<char, HN_KEY_TEXT_BYTES> text{};
    hn_format_key(text.data(), key.data());
    return text.data();
}

/* Return the public key of a host; its peer needs it. */
inline Key public_key(const PrivateKey &key)
{
    Key found{};
    if (!hn_derive_public(found.data(), key.own.data()))
        throw Error("libcrypto lacks X25519, as in FIPS mode");
    return found;
}

/* Return the key in a file that `hapticnet key new` made; without a path, that in ~/.config/hapticnet. */
inline PrivateKey load_key(const std::string &path = {})
{
    PrivateKey key;
    std::array<char, HN_WRONG_BYTES> wrong{};
    if (hn_load_key(path.empty() ? nullptr : path.c_str(), key.own.data(), key.psk.data(), wrong.data()) != nullptr)
        throw Error(wrong.data());
    return key;
}

/* Return the masters that a list admits; without a path, that in ~/.config/hapticnet. */
inline std::vector<Listed> load_masters(const std::string &path = {})
{
    std::vector<hn_listed> read(1000);
    std::array<char, HN_WRONG_BYTES> wrong{};
    std::size_t count = 0;
    const char *file = path.empty() ? nullptr : path.c_str();
    if (hn_load_masters(file, read.data(), read.size(), &count, wrong.data()) != nullptr)
        throw Error(wrong.data());
    std::vector<Listed> listed(count);
    for (std::size_t i = 0; i < count; i++) {
        std::copy_n(read[i].public_key, 32, listed[i].public_key.begin());
        std::copy_n(read[i].psk, 32, listed[i].psk.begin());
    }
    detail::wipe(read.data(), read.size() * sizeof(hn_listed));
    return listed;
}

#endif

/* The master. Each period, call tick, force and then send, until it returns nothing; after receive, send again.
 *
 * It cannot be copied or moved, because the library's state points into itself: keep it where it is made, or in a
 * std::unique_ptr. One thread at a time may use it. */
class Master {
  public:
    explicit Master(Request request, Random random = system_random())
        : request_(std::move(request)), random_(std::move(random))
    {
        hn_request asked{};
        asked.codec = request_.codec.c_str();
        asked.name = request_.name.c_str();
        asked.weber_fraction = request_.weber_fraction;
        asked.floor_n = request_.floor_n;
        asked.multiplier = request_.multiplier;
        asked.rate_hz = request_.rate_hz;
        asked.axes = request_.axes;
        asked.position_share = request_.position_share;
        asked.announced = request_.announced;
        asked.predicted = request_.predicted;
        if (request_.parameters.size() > HN_MOST_PARAMETERS)
            throw Error("parameters has " + std::to_string(request_.parameters.size()) +
                        " entries; a codec has at most " + std::to_string(HN_MOST_PARAMETERS));
        for (std::size_t i = 0; i < request_.parameters.size(); i++)
            asked.parameters[i] = {request_.parameters[i].first.c_str(), request_.parameters[i].second};
        more_.resize((hn_more_bytes(&asked) + sizeof(double) - 1) / sizeof(double));
        if (!more_.empty())
            asked.more = hn_more_init(more_.data(), &asked);
        if (const char *wrong = hn_master_init(&master_, &asked, detail::draw, &random_))
            throw detail::error(asked, wrong);
    }

    Master(const Master &) = delete;
    Master &operator=(const Master &) = delete;

#ifdef HAPTICNET_HAS_SEALED
    ~Master() { detail::wipe(&keys_, sizeof keys_); }

    /* Ask for sealed sessions only. Call it before the first tick. */
    void seal(const PrivateKey &key, const Key &slave_public)
    {
        const std::uint8_t *psk = key.psk == Key{} ? nullptr : key.psk.data();
        if (const char *wrong = hn_master_seal(&master_, &keys_, key.own.data(), slave_public.data(), psk))
            throw Error(wrong);
    }
#endif

    /* Give the position of this period. Without one, nothing is sent but what the session needs. */
    void tick(const Vector &position_m, Time now) noexcept { hn_master_tick(&master_, position_m.data(), now.count()); }
    void tick(Time now) noexcept { hn_master_tick(&master_, nullptr, now.count()); }

    /* Return the force to apply now. Limit it to what the device and a finger can bear. */
    Vector force(Time now) noexcept
    {
        Vector force_n{};
        hn_master_force(&master_, force_n.data(), now.count());
        return force_n;
    }

    /* Return the next datagram for the slave. */
    Datagram send() noexcept
    {
        Datagram datagram;
        datagram.size_ = hn_master_send(&master_, datagram.bytes_.data());
        return datagram;
    }

    void receive(const void *datagram, std::size_t size, Time now) noexcept
    {
        hn_master_receive(&master_, datagram, size, now.count());
    }

    /* End the session; then go on until the state is `closed`, which takes at most 250 ms. */
    void close(const char *reason, Time now) noexcept { hn_master_close(&master_, reason, now.count()); }

    State state() const noexcept { return static_cast<State>(hn_master_state(&master_)); }
    bool is_closed() const noexcept { return state() == State::closed; }

    /* Return why the slave refused, closed or warned, newest first. */
    Reason reason() const
    {
        unsigned code = 0;
        const char *text = hn_master_reason(&master_, &code);
        return {code, text};
    }

    std::string scene() const { return hn_master_scene(&master_); }
    hn_counts counts() const noexcept { return hn_master_counts(&master_); }

  private:
    Request request_; /* the library points to its texts */
    Random random_;
    hn_master master_{};
    std::vector<double> more_; /* memory of the library's, aligned as a double */
#ifdef HAPTICNET_HAS_SEALED
    hn_master_keys keys_{};
#endif
};

/* The slave, of one master at a time, with the codecs deadband and raw. Receive all that has arrived; if there is a
 * position, give `answer` the force there. It cannot be copied or moved; one thread at a time may use it. */
class Slave {
  public:
    explicit Slave(std::string scene, unsigned axes = 1, Random random = system_random())
        : scene_(std::move(scene)), random_(std::move(random))
    {
        hn_request said{};
        said.name = scene_.c_str();
        said.axes = axes;
        if (const char *wrong = hn_slave_init(&slave_, scene_.c_str(), axes, detail::draw, &random_))
            throw detail::error(said, wrong);
    }

    Slave(const Slave &) = delete;
    Slave &operator=(const Slave &) = delete;

#ifdef HAPTICNET_HAS_SEALED
    ~Slave()
    {
        detail::wipe(&keys_, sizeof keys_);
        detail::wipe(listed_.data(), listed_.size() * sizeof(hn_listed));
    }

    /* Serve sealed sessions only, of these masters. Call it before the first datagram. */
    void seal(const PrivateKey &key, const std::vector<Listed> &masters)
    {
        std::vector<hn_listed> listed(masters.size());
        for (std::size_t i = 0; i < masters.size(); i++) {
            std::copy_n(masters[i].public_key.begin(), 32, listed[i].public_key);
            std::copy_n(masters[i].psk.begin(), 32, listed[i].psk);
        }
        if (const char *wrong = hn_slave_seal(&slave_, &keys_, key.own.data(), listed.data(), listed.size())) {
            detail::wipe(listed.data(), listed.size() * sizeof(hn_listed));
            throw Error(wrong);
        }
        listed_ = std::move(listed); /* which keeps its elements where they are */
    }
#endif

    /* Take in a datagram; return the answer to where it came from. An address is at most HN_ADDRESS_BYTES. */
    Datagram receive(const void *datagram, std::size_t size, const void *address, std::size_t address_size,
                     Time now) noexcept
    {
        Datagram answer;
        answer.size_ =
            hn_slave_receive(&slave_, datagram, size, address, address_size, now.count(), answer.bytes_.data());
        return answer;
    }

    /* Return the position that waits for its force. */
    std::optional<Vector> position() const noexcept
    {
        Vector position_m{};
        if (!hn_slave_position(&slave_, position_m.data()))
            return std::nullopt;
        return position_m;
    }

    /* Return the answer: the force that pushes the tool out. One that is not finite ends the session. */
    Datagram answer(const Vector &force_n, Time now) noexcept
    {
        Datagram answer;
        answer.size_ = hn_slave_answer(&slave_, force_n.data(), now.count(), answer.bytes_.data());
        return answer;
    }

    /* End the session; the datagram tells the master. */
    Datagram close(const char *reason, unsigned code = HN_CODE_OTHER) noexcept
    {
        Datagram datagram;
        datagram.size_ = hn_slave_close(&slave_, reason, code, datagram.bytes_.data());
        return datagram;
    }

    /* Return the address of the session's master, and its size: nullptr and 0 if there is none. */
    std::pair<const void *, std::size_t> master() const noexcept
    {
        std::size_t size = 0;
        const void *address = hn_slave_master(&slave_, &size);
        return {address, address == nullptr ? 0 : size};
    }

    hn_counts counts() const noexcept { return hn_slave_counts(&slave_); }

  private:
    std::string scene_; /* the library points to it */
    Random random_;
    hn_slave slave_{};
#ifdef HAPTICNET_HAS_SEALED
    hn_slave_keys keys_{};
    std::vector<hn_listed> listed_;
#endif
};

} // namespace hapticnet

#endif
