// The reference beside: turbulence intensity by wind speed, and its errors against the bands of acceptance.

const acceptance = (holder, full) => {
  const { bins, bias_limit: biasLimit, rrmse_limit: rrmseLimit, prob, name } = data.reference;
  const width = panelWidth(holder, full);
  const range = extent(bins.speed);
  const x0 = [range[0] - 0.7, range[1] + 0.7];
  const panel = (title, values, yRange, description, draw) => {
    const svg = picture(width, 230, title, description);
    const box = { left: 46, right: width - 10, top: 24, bottom: 186 };
    const found = axes(svg, box, x0, yRange, {
      xTicks: ticks(...x0, width / 50).filter(([value]) => value >= 0), yTicks: ticks(...yRange, 5), xName: "wind speed, m/s", yName: title,
    });
    draw(found, box);
    holder.append(svg);
  };
  const flat = (value, y, box) => `M${box.left} ${y(value)}H${box.right}`;
  const few = bins.count.map((count) => (count < data.reference.few ? 1 : 0));
  const steps = (values, x, y) => bins.speed.map((speed, k) => (
    Number.isFinite(values[k]) ? `M${x(speed - 0.5)} ${y(values[k])}H${x(speed + 0.5)}` : "")).join("");
  const ends = [bins.ours, bins.theirs, bins.ours_high, bins.theirs_high].flatMap(finite);
  panel("TI: mean, representative", ends, [0, 1.1 * Math.max(...ends)], `Lidar and ${name}.`, ({ x, y, inside }) => {
    inside.append(path(steps(bins.theirs_high, x, y), "reference dashed"), path(steps(bins.ours_high, x, y), "middle dashed"));
    inside.append(path(steps(bins.theirs, x, y), "reference"), path(steps(bins.ours, x, y), "middle"));
  });
  const biases = finite([...bins.bias_low, ...bins.bias_high, ...bins.bias]);
  const most = Math.max(1.5 * biasLimit, ...biases.map(Math.abs)) * 1.1;
  panel("MRBE, %", biases, [-most, most], `Mean relative bias error, band ±${biasLimit} %.`, ({ x, y, inside }, box) => {
    inside.append(path(`M${box.left} ${y(biasLimit)}H${box.right}V${y(-biasLimit)}H${box.left}Z`, "accepted"), path(flat(0, y, box), "zero"));
    whiskers(inside, bins.speed.map((speed, k) => [x(speed), y(bins.bias[k]), bins.bias_low[k] === null ? NaN : y(bins.bias_low[k]), y(bins.bias_high[k])]), few);
  });
  const top = Math.max(1.5 * rrmseLimit, ...finite(bins.rrmse)) * 1.1;
  panel("RRMSE, %", bins.rrmse, [0, top], `Relative root mean square error, limit ${rrmseLimit} %.`, ({ x, y, inside }, box) => {
    inside.append(path(`M${box.left} ${y(rrmseLimit)}H${box.right}V${y(0)}H${box.left}Z`, "accepted"));
    whiskers(inside, bins.speed.map((speed, k) => [x(speed), y(bins.rrmse[k]), NaN, NaN]), few);
  });
  panel(`${prob} % intervals that hold it, %`, bins.coverage, [0, 105], `Share of the records, ${prob} % expected.`, ({ x, y, inside }, box) => {
    inside.append(path(flat(prob, y, box), "zero"));
    whiskers(inside, bins.speed.map((speed, k) => [x(speed), y(bins.coverage[k]), NaN, NaN]), few);
  });
};
