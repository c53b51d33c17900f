//! One layer of the network: over a whole square, or over the part that one result depends on.

use tch::Tensor;

/// A convolution: name, whether it is transposed, kernel, stride, padding.
#[derive(Debug, Clone, Copy)]
pub(super) struct Layer {
    pub(super) name: &'static str,
    pub(super) transposed: bool,
    pub(super) kernel: i64,
    stride: i64,
    padding: i64,
}

/// A convolution that leaves out the border.
pub(super) const fn valid(name: &'static str, kernel: i64) -> Layer {
    Layer { name, transposed: false, kernel, stride: 1, padding: 0 }
}

pub(super) const fn conv(name: &'static str, kernel: i64, stride: i64) -> Layer {
    Layer { name, transposed: false, kernel, stride, padding: kernel / 2 }
}

pub(super) const fn transposed(name: &'static str, stride: i64) -> Layer {
    Layer { name, transposed: true, kernel: 3, stride, padding: 1 }
}

/// Squares in larger ones, one for each of a batch: row and column of the north-western cell,
/// `[batch]`, cells along a side. They may reach beyond the border.
#[derive(Debug)]
pub(super) struct Rectangle {
    row: Tensor,
    column: Tensor,
    side: i64,
}

impl Layer {
    /// Cells along a side after the layer.
    pub(super) fn side(&self, side: i64) -> i64 {
        if self.transposed {
            (side - 1) * self.stride - 2 * self.padding + self.kernel
        } else {
            (side + 2 * self.padding - self.kernel) / self.stride + 1
        }
    }

    /// The layer over whole squares.
    pub(super) fn apply(&self, input: &Tensor, parameters: [&Tensor; 2]) -> Tensor {
        self.padded(input, parameters, self.padding, 0)
    }

    /// A transposed layer of stride 2 over whole squares, to squares of `side` cells: of the two
    /// sides that a convolution of stride 2 maps to the input's, either.
    pub(super) fn apply_to_side(
        &self,
        input: &Tensor,
        parameters: [&Tensor; 2],
        side: i64,
    ) -> Tensor {
        let more = side - self.side(input.size()[3]);
        self.padded(input, parameters, self.padding, more)
    }

    fn padded(
        &self,
        input: &Tensor,
        [weight, bias]: [&Tensor; 2],
        padding: i64,
        more: i64,
    ) -> Tensor {
        let (stride, padding) = ([self.stride; 2], [padding; 2]);
        if !self.transposed {
            return input.conv2d(weight, Some(bias), stride, padding, [1, 1], 1);
        }
        let with = |bias: Option<&Tensor>| {
            input.conv_transpose2d(weight, bias, stride, padding, [more; 2], 1, [1, 1])
        };
        if self.stride == 1 {
            return with(Some(bias));
        }
        // oneDNN is ten times slower if it is to add the bias to numbers of 16 bits itself.
        with(None).g_add_(&bias.view([-1, 1, 1]))
    }

    /// The part of the input that a part of the output depends on.
    pub(super) fn source(&self, part: &Rectangle) -> Rectangle {
        let Self { kernel, stride, padding, .. } = *self;
        if !self.transposed {
            let side = stride * (part.side - 1) + kernel;
            return part.with(side, |at| at * stride - padding);
        }
        // Input i reaches the outputs from stride · i - padding on, kernel of them.
        let side =
            (part.side + kernel - 2).unsigned_abs().div_ceil(stride.unsigned_abs()) as i64 + 1;
        part.with(side, |at| (at + padding + 1 - kernel).divide_scalar_mode(stride, "floor"))
    }

    /// The layer over the source of a part, which gives that part.
    pub(super) fn apply_to_part(
        &self,
        input: &Tensor,
        parameters: [&Tensor; 2],
        source: &Rectangle,
        part: &Rectangle,
    ) -> Tensor {
        if !self.transposed {
            return self.padded(input, parameters, 0, 0);
        }
        // All outputs that the source reaches, of which some depend on more than it.
        let out = self.padded(input, parameters, 0, 0);
        let first = |at: &Tensor, source: &Tensor| at - (source * self.stride - self.padding);
        let (row, column) = (first(&part.row, &source.row), first(&part.column, &source.column));
        Rectangle { row, column, side: part.side }.cut(&out)
    }
}

impl Rectangle {
    /// Squares around cells at positions in row-major order, `[batch]`.
    pub(super) fn cells(positions: &Tensor, side: i64) -> Self {
        let row = positions.divide_scalar_mode(side, "floor");
        let column = positions - &row * side;
        Self { row, column, side: 1 }
    }

    fn with(&self, side: i64, change: impl Fn(&Tensor) -> Tensor) -> Self {
        Self { row: change(&self.row), column: change(&self.column), side }
    }

    /// The rows (or columns) of the parts: `[batch, side]`.
    fn lines(&self, first: &Tensor) -> Tensor {
        let steps = Tensor::arange(self.side, (first.kind(), first.device()));
        first.unsqueeze(1) + steps
    }

    /// The parts of a batch of squares, `[batch, channels, side, side]`; beyond the border they
    /// hold 0.
    pub(super) fn cut(&self, of: &Tensor) -> Tensor {
        let (batch, channels, height, _) = of.size4().expect("a batch of squares");
        let last = height - 1;
        let [rows, columns] =
            [&self.row, &self.column].map(|first| self.lines(first).clamp(0, last));
        let squares =
            Tensor::arange(batch, (rows.kind(), rows.device())).view([-1, 1, 1]) * height * height;
        let at = squares + rows.unsqueeze(2) * height + columns.unsqueeze(1);
        let cells = of.permute([0, 2, 3, 1]).reshape([-1, channels]);
        let cut = cells.index_select(0, &at.flatten(0, -1));
        let cut = cut.view([batch, self.side, self.side, channels]).permute([0, 3, 1, 2]);
        self.inside(&cut, height)
    }

    /// Sets to 0 what of the parts lies beyond squares of `side` cells, as padding would.
    pub(super) fn inside(&self, values: &Tensor, side: i64) -> Tensor {
        let [rows, columns] = [&self.row, &self.column].map(|first| {
            let lines = self.lines(first);
            lines.ge(0).logical_and(&lines.lt(side)).to_kind(values.kind())
        });
        values * (rows.unsqueeze(2) * columns.unsqueeze(1)).unsqueeze(1)
    }
}
