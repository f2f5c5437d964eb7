// Lines of text over TCP, none lost, whether read at once or later.
#pragma once
#include <netdb.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <stdexcept>
#include <string>
#include <vector>

namespace deltaq {

class Lines {
 public:
  Lines(const std::string& host, const std::string& port) : address_(host + ":" + port) {
    addrinfo hints{}, *found = nullptr;
    hints.ai_socktype = SOCK_STREAM;
    if (getaddrinfo(host.c_str(), port.c_str(), &hints, &found) != 0) gone("is not known");
    socket_ = ::socket(found->ai_family, SOCK_STREAM, 0);
    const bool is_connected = ::connect(socket_, found->ai_addr, found->ai_addrlen) == 0;
    freeaddrinfo(found);
    if (!is_connected) gone("cannot be reached");
    const timeval silence{2, 0};
    const int yes = 1;
    setsockopt(socket_, SOL_SOCKET, SO_RCVTIMEO, &silence, sizeof silence);
    setsockopt(socket_, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
  }
  Lines(const Lines&) = delete;
  Lines& operator=(const Lines&) = delete;
  ~Lines() { close(); }

  void say(const std::string& text) {
    const std::string line = text + "\n";
    if (::send(socket_, line.data(), line.size(), MSG_NOSIGNAL) != static_cast<ssize_t>(line.size()))
      gone("has closed the connection; the robot comes to rest");
  }

  /// Lines that have come; waits for some if there are none and `wait` says so.
  std::vector<std::string> take(bool wait) {
    char bytes[65536];
    for (;;) {
      const ssize_t count = recv(socket_, bytes, sizeof bytes, wait ? 0 : MSG_DONTWAIT);
      if (count < 0 && errno == EINTR) continue;
      const bool has_line = received_.find('\n') != std::string::npos;  // the last words come first
      const bool is_closed = count == 0 || (count < 0 && errno == ECONNRESET);
      if (is_closed && !has_line) gone("has closed the connection; the robot comes to rest");
      if (count < 0 && wait) gone("does not answer any more; the robot comes to rest");
      if (count <= 0) break;
      received_.append(bytes, static_cast<std::size_t>(count));
      wait = received_.find('\n') == std::string::npos;
    }
    std::vector<std::string> lines;
    std::size_t begin = 0;
    for (std::size_t end; (end = received_.find('\n', begin)) != std::string::npos; begin = end + 1)
      lines.push_back(received_.substr(begin, end - begin));
    received_.erase(0, begin);
    return lines;
  }

 private:
  std::string address_, received_;
  int socket_ = -1;

  void close() {
    if (socket_ >= 0) ::close(socket_);
    socket_ = -1;
  }

  [[noreturn]] void gone(const std::string& why) {
    close();  // a constructor that throws has no destructor to do it
    throw std::runtime_error("unreachable: " + address_ + " " + why);
  }
};

}  // namespace deltaq
