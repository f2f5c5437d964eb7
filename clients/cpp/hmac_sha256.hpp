// HMAC-SHA256 (RFC 2104, FIPS 180-4) of a text, in hexadecimal digits: it shows a token without sending it.
#pragma once
#include <array>
#include <cmath>
#include <cstdint>
#include <string>

namespace deltaq {

/// The 32 bytes of SHA-256.
inline std::string sha256(std::string text) {
  const auto part = [](long double root) { return static_cast<std::uint32_t>((root - std::floor(root)) * 4294967296.0L); };
  const auto turned = [](std::uint32_t word, int bits) { return word >> bits | word << (32 - bits); };
  std::array<std::uint32_t, 64> k, w;
  std::array<std::uint32_t, 8> h;
  for (int n = 0, candidate = 2; n < 64; candidate++) {  // of the first 64 primes
    bool is_prime = true;
    for (int d = 2; d * d <= candidate; d++) is_prime = is_prime && candidate % d;
    if (!is_prime) continue;
    k[n] = part(std::cbrt(static_cast<long double>(candidate)));
    if (n < 8) h[n] = part(std::sqrt(static_cast<long double>(candidate)));
    n++;
  }
  const std::uint64_t bits = 8 * static_cast<std::uint64_t>(text.size());
  text += static_cast<char>(0x80);
  while (text.size() % 64 != 56) text += '\0';
  for (int shift = 56; shift >= 0; shift -= 8) text += static_cast<char>(bits >> shift);
  for (std::size_t block = 0; block < text.size(); block += 64) {
    for (int i = 0; i < 16; i++) {
      w[i] = 0;
      for (int byte = 0; byte < 4; byte++) w[i] = w[i] << 8 | static_cast<unsigned char>(text[block + 4 * i + byte]);
    }
    for (int i = 16; i < 64; i++) {
      const std::uint32_t s0 = turned(w[i - 15], 7) ^ turned(w[i - 15], 18) ^ w[i - 15] >> 3;
      const std::uint32_t s1 = turned(w[i - 2], 17) ^ turned(w[i - 2], 19) ^ w[i - 2] >> 10;
      w[i] = w[i - 16] + s0 + w[i - 7] + s1;
    }
    std::array<std::uint32_t, 8> v = h;
    for (int i = 0; i < 64; i++) {
      const std::uint32_t s1 = turned(v[4], 6) ^ turned(v[4], 11) ^ turned(v[4], 25);
      const std::uint32_t t1 = v[7] + s1 + ((v[4] & v[5]) ^ (~v[4] & v[6])) + k[i] + w[i];
      const std::uint32_t s0 = turned(v[0], 2) ^ turned(v[0], 13) ^ turned(v[0], 22);
      const std::uint32_t t2 = s0 + ((v[0] & v[1]) ^ (v[0] & v[2]) ^ (v[1] & v[2]));
      v = {t1 + t2, v[0], v[1], v[2], v[3] + t1, v[4], v[5], v[6]};
    }
    for (int i = 0; i < 8; i++) h[i] += v[i];
  }
  std::string digest;
  for (std::uint32_t word : h)
    for (int shift = 24; shift >= 0; shift -= 8) digest += static_cast<char>(word >> shift);
  return digest;
}

inline std::string hmac_sha256(std::string key, const std::string& text) {
  if (key.size() > 64) key = sha256(key);
  key.resize(64, '\0');
  std::string inner, outer, digits;
  for (char byte : key) inner += static_cast<char>(byte ^ 0x36), outer += static_cast<char>(byte ^ 0x5c);
  for (unsigned char byte : sha256(outer + sha256(inner + text))) digits += "0123456789abcdef"[byte >> 4], digits += "0123456789abcdef"[byte & 15];
  return digits;
}

}  // namespace deltaq
