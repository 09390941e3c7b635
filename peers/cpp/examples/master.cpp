// A master that moves in and out of a scene for five seconds, and prints what a hand would feel.
// First: hapticnet slave --scene paper. Then: master [HOST [PORT [SECONDS]]]
#include <arpa/inet.h>
#include <cmath>
#include <cstdio>
#include <thread>
#include <unistd.h>

#include "hapticnet.hpp"

int main(int argc, char **argv)
try {
    hapticnet::Request request;
    request.name = "smallest";
    hapticnet::Master master(request);

    int port = 47800, link = socket(AF_INET, SOCK_DGRAM, 0);
    double seconds = 5.0;
    char rest; // after a number there must be nothing
    const bool good = (argc < 3 || std::sscanf(argv[2], "%d%c", &port, &rest) == 1) && 1 <= port && port <= 65535 &&
                      (argc < 4 || std::sscanf(argv[3], "%lf%c", &seconds, &rest) == 1) && 0 < seconds &&
                      seconds <= 1e6;
    sockaddr_in slave{};
    slave.sin_family = AF_INET;
    slave.sin_port = htons(static_cast<std::uint16_t>(port));
    if (!good || inet_pton(AF_INET, argc > 1 ? argv[1] : "127.0.0.1", &slave.sin_addr) != 1 ||
        connect(link, reinterpret_cast<sockaddr *>(&slave), sizeof slave) != 0)
        throw hapticnet::Error("usage: master [IPv4-ADDRESS [PORT [SECONDS]]]");

    std::uint8_t data[hapticnet::RECEIVE_BYTES];
    const auto start = std::chrono::steady_clock::now();
    for (int tick = 0; !master.is_closed(); tick++) {
        std::this_thread::sleep_until(start + std::chrono::milliseconds(tick));
        for (ssize_t size; (size = recv(link, data, sizeof data, MSG_DONTWAIT)) > 0;)
            master.receive(data, static_cast<std::size_t>(size), hapticnet::now());
        const double x_m = 0.015 * (1.0 - std::cos(6.283185307 * tick * 1e-3 / seconds));
        master.tick({x_m}, hapticnet::now());
        const double force_n = master.force(hapticnet::now())[0]; // what a device would apply
        if (tick % 100 == 0)
            std::printf("%6.2f mm  %6.2f N%s\n", x_m * 1e3, force_n,
                        master.state() == hapticnet::State::established ? "" : "  no session with the slave");
        if (tick == static_cast<int>(seconds * 1e3))
            master.close("done", hapticnet::now());
        while (auto datagram = master.send())
            send(link, datagram.data(), datagram.size(), MSG_DONTWAIT);
    }
} catch (const hapticnet::Error &error) {
    std::fprintf(stderr, "%s\n", error.what());
    return 2;
}
