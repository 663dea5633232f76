// Run an exported network on one image with ONNX Runtime, without Python.
//
//   roadtorch export fusion --mask --out road.onnx
//   g++ -std=c++17 -O2 infer.cpp -I ORT/include -L ORT/lib -lonnxruntime -o infer
//   ./infer road.onnx street.ppm road.pgm
//
// ORT is a release of ONNX Runtime (Debian 13: libonnxruntime-dev). Images are binary PPM (P6), so
// that no library is needed; with OpenCV, `rgb` is image.data of a cv::Mat in RGB.

#include <onnxruntime_cxx_api.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <iostream>
#include <stdexcept>
#include <string>
#include <vector>

struct Image {
    int64_t height = 0, width = 0;
    std::vector<uint8_t> rgb;  // row by row, red, green, blue
};

Image read_ppm(const std::string& path) {
    std::ifstream file(path, std::ios::binary);
    std::string kind;
    int64_t levels = 0;
    Image image;
    file >> kind >> image.width >> image.height >> levels;
    file.get();
    if (!file || kind != "P6" || levels != 255) throw std::runtime_error(path + ": no binary PPM");
    image.rgb.resize(image.height * image.width * 3);
    file.read(reinterpret_cast<char*>(image.rgb.data()), image.rgb.size());
    if (!file) throw std::runtime_error(path + ": is cut");
    return image;
}

int main(int count, char** words) try {
    if (count != 4) throw std::runtime_error("usage: infer MODEL.onnx IMAGE.ppm MASK.pgm");

    Ort::Env environment(ORT_LOGGING_LEVEL_ERROR, "roadtorch");
    Ort::SessionOptions options;
    options.SetIntraOpNumThreads(1);
    Ort::Session session(environment, words[1], options);

    Image image = read_ppm(words[2]);
    const std::array<int64_t, 4> shape = {1, image.height, image.width, 3};
    auto memory = Ort::MemoryInfo::CreateCpu(OrtArenaAllocator, OrtMemTypeDefault);
    auto input = Ort::Value::CreateTensor<uint8_t>(
        memory, image.rgb.data(), image.rgb.size(), shape.data(), shape.size());

    const char* given[] = {"image"};
    const char* wanted[] = {"mask", "trust"};  // trust: of fusion, fusion:large and fusion:scratch
    auto found = session.Run(Ort::RunOptions{nullptr}, given, &input, 1, wanted, 2);
    const uint8_t* mask = found[0].GetTensorData<uint8_t>();  // height × width, 1 road
    const float trust = found[1].GetTensorData<float>()[0];

    std::ofstream map(words[3], std::ios::binary);
    map << "P5\n" << image.width << " " << image.height << "\n255\n";
    const int64_t pixels = image.height * image.width;
    int64_t road = 0;
    for (int64_t at = 0; at < pixels; ++at) {
        road += mask[at];
        map.put(static_cast<char>(mask[at] * 255));
    }
    std::cout << image.width << "x" << image.height << ", road " << 100 * road / pixels
              << " %, trust " << std::round(100 * trust) / 100 << "\n";
} catch (const std::exception& problem) {
    std::cerr << "infer: error: " << problem.what() << "\n";
    return 1;
}
